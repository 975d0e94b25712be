"""Standing elastic wave, with and without hyperviscosity: rho s^2 + (G_v k^2 + mu k^4) s + G_e k^2 = 0.
Run with ``python demos/wave/wave.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import CF, Integrate, cos, pi, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.plots import figure

K, G_E, G_V, A, DT = 2.0, 1.0, 0.02, 1e-4, 0.04  # wave number 1/m, Pa, Pa s, m/s, s


def dispersion(mu: float) -> complex:
    """s in 1/s: the decay is -Re s, the phase speed |Im s|/k."""
    return complex(np.roots([1.0, G_V * K**2 + mu * K**4, G_E * K**2])[0])


def amplitudes(mu: float, steps: int) -> tuple[nv.Simulation, np.ndarray]:
    """Amplitudes of v_2 in a strip of one wave length, periodic in x and y, at every step."""
    laws = {"hyperviscosity": nv.HyperViscosity(mu=mu, p=2)} if mu else {}
    laws["viscosity"] = nv.StokesViscosity(K_v=0.0, G_v=G_V)
    model = nv.Model(material=nv.LinearElastic(K_e=2.0, G_e=G_E), **laws)
    start, mesh = nv.Initial(velocity=CF((0, A * cos(K * x)))), box((pi, 0.8), 0.4, periodic="xy")
    orders = nv.Discretisation(k=3, m=2)
    run = nv.Simulation(mesh, model, dt=DT, initial=start, discretisation=orders)
    values = [A]
    while run.number < steps:
        run.advance()
        values.append(Integrate(run.fields["velocity"][1] * cos(K * x), mesh) / (0.4 * pi))
    return run, np.array(values)


def exponent(a: np.ndarray) -> complex:
    """s of a_n+1 = (z + z*) a_n - |z|^2 a_n-1: an implicit step multiplies by z = 1/(1 - s dt)."""
    b = np.linalg.lstsq(np.array([a[2:-1], a[1:-2]]).T, a[3:], rcond=None)[0]
    return complex((1 - 1 / np.roots([1.0, -b[0], -b[1]])[0]) / DT)


def main(directory: str = "results/wave", steps: int = 60) -> dict[float, tuple]:
    (fig, ((axis,),)), results = figure(1, 1, (7, 4)), {}
    for mu in (0.0, 0.02):
        run, a = amplitudes(mu, steps)
        s, exact = exponent(a), dispersion(mu)
        results[mu] = run, s, exact
        speeds, decays = [abs(q.imag) / K for q in (s, exact)], [-s.real, -exact.real]
        print(f"mu = {mu}: speed and exact speed {speeds} m/s, decays {decays} 1/s")
        axis.plot(DT * np.arange(steps + 1), a / A)
    axis.set(xlabel="time, s", ylabel="v₂, relative", title="mu = 0 (blue), 0.02 Pa s m² (orange)")
    Path(directory).mkdir(parents=True, exist_ok=True)
    fig.savefig(Path(directory) / "wave.png")
    return results


if __name__ == "__main__":
    main(*sys.argv[1:2])
