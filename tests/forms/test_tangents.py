"""The elastic force of jumps leaves no thrust, whatever the energy of the material."""

import numpy as np
import pytest
from materials import examples
from ngsolve import CF, GridFunction
from support import block, residual, uncondensed

import ngvisco as nv
from ngvisco.forms.fields import Fields
from ngvisco.forms.start.initial import complete
from ngvisco.forms.system import Step
from ngvisco.forms.terms.tangents import TangentForce
from ngvisco.forms.terms.transport import ElasticForce
from ngvisco.geometries import structured_box
from ngvisco.physics.pointwise import states_of

MATERIALS = {f"{e.constructor}, {e.energy}": e.material for e in examples()}
MATERIALS["Yosida"] = nv.Yosida(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0), eps=0.01)
KINDS = (ElasticForce,), (ElasticForce, TangentForce)


def jumping(material):
    """A step of a periodic box with constants in cells, which differ by strains of some 0.1."""
    mesh = structured_box((1.0, 1.0), (3, 3), periodic="xy")
    step = Step(mesh, nv.Model(material=material), nv.Discretisation(m=0))
    step.context.tau.Set(0.1)
    rng, count = np.random.default_rng(0), mesh.ne
    F = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    F[:, :2, :2] += 0.1 * rng.uniform(-1, 1, (count, 2, 2))
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["z"].vec.FV().NumPy()[:] = states_of(material, F, 2).T.ravel()
    parts["rho"].Set(CF(1.0))
    complete(step)
    step.local_unknowns.update()
    return step


def rows(step, *kinds):
    """The rows of v of the terms of these kinds, N."""
    trial, test = (Fields.of(step.layout, f) for f in step.layout.space.TnT())
    parts = [part for term in step.terms if isinstance(term, kinds) for part in term.form(trial, test)]
    return block(step, residual(uncondensed(step, parts), step.state.vec), "v")


def thrust(step, *kinds):
    """The force, N, of the terms of these kinds on the body as a whole, (2,)."""
    force, v = rows(step, *kinds), GridFunction(step.layout.blocks["v"])
    result = []
    for e in (1.0, 0.0), (0.0, 1.0):
        v.Set(CF(e))
        result.append(force @ v.vec.FV().NumPy())
    return np.array(result)


@pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS.keys())
def test_jumps_of_the_state_cause_no_net_force(material):
    step = jumping(material)
    size = abs(rows(step, ElasticForce)).sum()
    alone, kept = (np.abs(thrust(step, *kinds)).max() / size for kinds in KINDS)
    assert kept <= 1e-14
    is_quadratic = type(material) is nv.LinearElastic
    assert (alone <= 1e-14) if is_quadratic else (1e-8 < alone < 0.1)
