"""Terms with a wrong sign or factor, and the tests of the default suite that see each.

``python tests/mutants.py [names]`` makes each change to a copy of the sources and runs its test there, which
has to fail; ``tests/test_mutants.py`` does so where it is asked for long tests, and says always whether each
change still fits.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIGNS = "tests/forms/test_signs_of_terms.py::"
MOMENTUM = "tests/run/test_momentum_columns.py::"


@dataclass(frozen=True)
class Mutant:
    """A change of one place of a file, and the test that has to fail with it."""

    name: str
    file: str
    old: str
    new: str
    seen_by: str


def _of(file: str, *changes: tuple[str, str, str, str]) -> list[Mutant]:
    return [Mutant(name, f"ngvisco/{file}", old, new, seen_by) for name, old, new, seen_by in changes]


_CLOSURE = "tests/run/test_ledger.py::test_closure_is_the_residual_tested_by_the_solution"
_POWERS = "tests/run/test_ledger.py::test_dissipations_are_the_powers_of_their_forms"

MUTANTS = [
    *_of(
        "forms/terms/momentum.py",
        (
            "compensation of inertia",
            "- 0.5 * (u.rho - c.old.rho) * u.v",
            "+ 0.5 * (u.rho - c.old.rho) * u.v",
            _CLOSURE,
        ),
        (
            "both halves of convection",
            "return [0.5 * inner(u.grad_v * flux, w.v), -0.5 * inner(w.grad_v * flux, u.v)]",
            "return [-0.5 * inner(u.grad_v * flux, w.v), 0.5 * inner(w.grad_v * flux, u.v)]",
            MOMENTUM + "test_inertia_keeps_momentum_and_what_it_loses_of_rotations_is_seen",
        ),
        (
            "loads",
            "return u.rho * average if isinstance(self.load, (Gravity, CentralGravity)) else average",
            "return -(u.rho * average if isinstance(self.load, (Gravity, CentralGravity)) else average)",
            SIGNS + "test_loads_pull_where_they_point",
        ),
        (
            "viscous stress",
            "return [inner(self.viscosity.stress(sym(u.L), self._values(u)), w.L)]",
            "return [-inner(self.viscosity.stress(sym(u.L), self._values(u)), w.L)]",
            _POWERS,
        ),
        (
            "balance of inertia",
            "0.5 * inner(u.parts[UnbalancedMomentum.name], w.v),",
            "-0.5 * inner(u.parts[UnbalancedMomentum.name], w.v),",
            _CLOSURE,
        ),
        (
            "flux of the density",
            "return [c.rate(u.rho - c.old.rho) * w.rho, -carried * (u.v * w.grad_rho)]",
            "return [c.rate(u.rho - c.old.rho) * w.rho, carried * (u.v * w.grad_rho)]",
            SIGNS + "test_the_density_is_carried_along_by_the_flow",
        ),
    ),
    *_of(
        "forms/terms/transport.py",
        (
            "elastic force in cells",
            '        return transport_in_cells(w, u, u, "zeta")',
            '        return [-part for part in transport_in_cells(w, u, u, "zeta")]',
            _CLOSURE,
        ),
        (
            "what creep takes",
            'return [-part for part in rates.creep_power(u, rates.creep(u), w, "z")]',
            'return [part for part in rates.creep_power(u, rates.creep(u), w, "z")]',
            _CLOSURE,
        ),
        (
            "growth of the plastic strain",
            "return [-rates.hardening_rate(self.flow, Pi, u) * w.z_tensors",
            "return [rates.hardening_rate(self.flow, Pi, u) * w.z_tensors",
            SIGNS + "test_plastic_strain_grows_by_the_equivalent_rate",
        ),
    ),
    *_of(
        "physics/flow_rules/rule.py",
        (
            "factor of the plastic strain",
            "return math.sqrt(2 / 3) * (size",
            "return math.sqrt(3 / 2) * (size",
            SIGNS + "test_plastic_strain_grows_by_the_equivalent_rate",
        ),
    ),
    *_of(
        "forms/rates.py",
        (
            "energy in the pressure",
            "return (-1 / 3) * power - self.stored(u)",
            "return (-1 / 3) * power + self.stored(u)",
            SIGNS + "test_the_pressure_that_laws_read_is_that_of_the_stress",
        ),
    ),
    *_of(
        "physics/materials/thermal.py",
        (
            "Grueneisen's parameter",
            "return self._Gamma * (log(J) if self.is_absolute else J - 1)",
            "return -self._Gamma * (log(J) if self.is_absolute else J - 1)",
            SIGNS + "test_what_is_hot_presses_outward",
        ),
    ),
    *_of(
        "forms/boundary/wall_terms.py",
        (
            "given pressure",
            "load = -c.average(self.pressure, self.region) * c.normal",
            "load = c.average(self.pressure, self.region) * c.normal",
            SIGNS + "test_a_pressure_on_an_open_wall_pushes_inward",
        ),
        (
            "impedance",
            "return _along_and_across(self.impedance, u.v, u.context.normal)",
            "return -_along_and_across(self.impedance, u.v, u.context.normal)",
            SIGNS + "test_an_impedance_brakes_along_and_across_by_its_own_factors",
        ),
        (
            "factors along and across",
            "    p, s = factors",
            "    s, p = factors",
            SIGNS + "test_an_impedance_brakes_along_and_across_by_its_own_factors",
        ),
        (
            "springs",
            "        return [self._work(u.parts[self.displacement], w.v, u)]",
            "        return [-self._work(u.parts[self.displacement], w.v, u)]",
            SIGNS + "test_springs_pull_back_by_what_the_wall_has_moved",
        ),
        (
            "traction",
            "return _tangential(u.context.average(self.f, self.region), u.context.normal)",
            "return -_tangential(u.context.average(self.f, self.region), u.context.normal)",
            SIGNS + "test_friction_brakes_and_a_traction_pulls",
        ),
        (
            "friction",
            "parts.append(self.indicator * self.friction * (_tangential(u.v, u.context.normal) * w.v))",
            "parts.append(-self.indicator * self.friction * (_tangential(u.v, u.context.normal) * w.v))",
            SIGNS + "test_friction_brakes_and_a_traction_pulls",
        ),
        (
            "carried momentum",
            "            (0.5 * self._carried_momentum(u)) * (w.v * u.v),",
            "            (-0.5 * self._carried_momentum(u)) * (w.v * u.v),",
            SIGNS + "test_what_flows_in_brings_its_momentum",
        ),
    ),
    *_of(
        "forms/terms/tangents.py",
        (
            "tangents' force",
            "return [(w.v * u.context.normal) * self.excess(u)]",
            "return [-(w.v * u.context.normal) * self.excess(u)]",
            _CLOSURE,
        ),
    ),
    *_of(
        "forms/upwinding.py",
        (
            "upwinding of both row and column",
            "return if_positive(through, through, -through)",
            "return -if_positive(through, through, -through)",
            MOMENTUM + "test_what_a_jump_makes_of_nothing_is_in_the_columns",
        ),
    ),
    *_of(
        "forms/terms/hyperviscosity.py",
        (
            "penalty of the hyperviscosity",
            "parts.append(self.stiffness(u) * inner(u.jump, w.jump))",
            "parts.append(-self.stiffness(u) * inner(u.jump, w.jump))",
            _POWERS,
        ),
    ),
    *_of(
        "forms/boundary/reactions.py",
        (
            "stress of a closed wall",
            "return phi - inner(masked(u.z, by_flux), u.zeta) if by_flux.any() else phi",
            "return phi",
            MOMENTUM + "test_a_floor_bears_the_weight",
        ),
    ),
    *_of(
        "forms/terms/regularisation.py",
        (
            "damping of the velocity",
            "return [self.law.friction(square(u.v)) * inner(u.v, w.v)]",
            "return [-self.law.friction(square(u.v)) * inner(u.v, w.v)]",
            SIGNS + "test_damping_of_the_velocity_brakes",
        ),
    ),
    *_of(
        "forms/terms/heat.py",
        (
            "heat that is made",
            "return [-(reduce(add, heat) * self.chi(u, w))] if heat else []",
            "return [reduce(add, heat) * self.chi(u, w)] if heat else []",
            "tests/forms/test_heat.py::test_what_further_terms_dissipate_is_heat_or_refused",
        ),
        (
            "heat through walls",
            "heat = flux + coefficient * (temperature - self.theta(u))",
            "heat = flux - coefficient * (temperature - self.theta(u))",
            "tests/forms/test_heat.py::test_heat_from_sources_and_through_walls_is_in_the_energy",
        ),
    ),
    *_of(
        "forms/impulses.py",
        (
            "half of what is carried in the columns of momentum",
            "_SKEW: [Integrand(facets=-half)],",
            "_SKEW: [Integrand(facets=half)],",
            MOMENTUM + "test_momentum_changes_by_the_impulses_and_by_what_the_columns_say",
        ),
        (
            "thrust of jumps in the columns of momentum",
            "return u.context.crossed * (inner(u.z_hat - u.z, u.zeta) + phi)",
            "return u.context.crossed * (inner(u.z - u.z_hat, u.zeta) + phi)",
            MOMENTUM + "test_jumps_of_smooth_states_push_nothing",
        ),
    ),
]


def copy_with(mutant: Mutant, folder: Path) -> None:
    """A copy of the sources and tests with the change."""
    for name in ("ngvisco", "geometries", "tests"):
        ignored = shutil.ignore_patterns("pictures", "__pycache__")
        shutil.copytree(ROOT / name, folder / name, ignore=ignored, dirs_exist_ok=True)
    shutil.copy(ROOT / "pyproject.toml", folder)
    path = folder / mutant.file
    path.write_text(path.read_text(encoding="utf-8").replace(mutant.old, mutant.new), encoding="utf-8")


def seen(mutant: Mutant, folder: Path) -> bool:
    """Whether its test fails in the copy; raises RuntimeError where it did not come to run."""
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        "NGS_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", mutant.seen_by]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)
    if result.returncode not in (0, 1):
        raise RuntimeError(f"{mutant.name}: {mutant.seen_by} did not run\n{result.stdout[-2000:]}")
    return result.returncode == 1


def main(names: list[str]) -> int:
    """Say of each change whether it is seen."""
    silent = 0
    for mutant in MUTANTS:
        if names and mutant.name not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            copy_with(mutant, Path(folder))
            found = seen(mutant, Path(folder))
        silent += not found
        print(f"{'seen' if found else 'SILENT':7s} {mutant.name}: {mutant.seen_by}", flush=True)
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
