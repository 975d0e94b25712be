"""A standing elastic wave with and without hyperviscosity: rho s^2 + (G_v k^2 + mu k^4) s + G_e k^2 = 0.
Run with ``python demos/wave/wave.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import CF, Integrate, cos, pi, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.pictures import figure

K, G_E, G_V, A, DT = 2.0, 1.0, 0.02, 1e-4, 0.04  # wave number 1/m, Pa, Pa s, m/s, s


def dispersion(mu: float) -> complex:
    """The exact rate s, 1/s, of which -Re s is the decay and |Im s|/k the phase speed."""
    return complex(np.roots([1.0, G_V * K**2 + mu * K**4, G_E * K**2])[0])


def amplitudes(mu: float, steps: int, scheme: str = "midpoint") -> tuple[nv.Simulation, np.ndarray]:
    """Amplitudes of v_2 in a strip of one wave length, periodic in x and y, at every step."""
    viscosity, hyper = nv.StokesViscosity(K_v=0.0, G_v=G_V), nv.HyperViscosity(mu=mu, p=2) if mu else None
    model = nv.Model(material=nv.LinearElastic(K_e=2.0, G_e=G_E), viscosity=viscosity, hyperviscosity=hyper)
    start, mesh = nv.Initial(velocity=CF((0, A * cos(K * x)))), box((pi, 0.8), 0.4, periodic="xy")
    orders = nv.Discretisation(k=3, m=2)
    run = nv.Simulation(mesh, model, dt=DT, initial=start, discretisation=orders, scheme=scheme)
    values = [A]
    while run.number < steps:
        run.advance()
        values.append(Integrate(run.fields["velocity"][1] * cos(K * x), mesh) / (0.4 * pi))
    return run, np.array(values)


def exponent(a: np.ndarray) -> complex:
    """The rate s, 1/s, of the computed wave, a_n+1 = (z + z*) a_n - |z|^2 a_n-1 with z = exp(s dt)."""
    b = np.linalg.lstsq(np.array([a[2:-1], a[1:-2]]).T, a[3:], rcond=None)[0]
    return complex(np.log(np.roots([1.0, -b[0], -b[1]])[0]) / DT)


def main(directory: str = "results/wave", steps: int = 60) -> dict[tuple[float, str], tuple]:
    (fig, (axes,)), results, t = figure(1, 2, (11, 4)), {}, DT * np.arange(steps + 1)
    for mu, axis in zip((0.0, 0.02), axes, strict=True):
        s = dispersion(mu)
        axis.plot(t, np.real(np.exp(s * t) * (1 - 1j * s.real / s.imag)), "k", lw=6, alpha=0.2, label="exact")
        for scheme, style in (("midpoint", "C0"), ("backward-euler", "C3--")):
            run, a = amplitudes(mu, steps, scheme)
            results[mu, scheme] = run, (found := exponent(a)), s
            axis.plot(t, a / A, style, label=f"{scheme}: s = {found:.4f} 1/s")
        axis.set(xlabel="time, s", ylabel="v₂, relative", title=f"μ = {mu} Pa s m²: s = {s:.4f} 1/s")
        axis.legend()
    Path(directory).mkdir(parents=True, exist_ok=True)
    fig.savefig(Path(directory) / "wave.png", dpi=110)
    return results


if __name__ == "__main__":
    main(*sys.argv[1:2])
