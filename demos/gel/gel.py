"""A damped gel layer is pushed sideways and rings down by its loss factor at the frequency of the ring.
Run with ``python demos/gel/gel.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import pi, sin, y

import ngvisco as nv
from ngvisco.geometries import channel
from ngvisco.run.pictures import figure

G, SHARE, RHO, K, A, DT = 100.0, 0.4, 1000.0, np.pi / 2, 1e-3, 0.2  # Pa, 1, kg/m³, 1/m, m/s, s
TIMES = {"soon": 0.2, "at its peak": 1.7, "late": 15.0}  # s; 1/omega is between 1.7 s and 2 s


def modulus(s: complex, tau: float) -> complex:
    """The modulus G(s), Pa; G(i omega) is the complex modulus, and the constant G is the limit for s -> 0."""
    return G * (1 + SHARE * s * tau / (1 + s * tau))


def exact(tau: float, t: np.ndarray) -> tuple[complex, np.ndarray]:
    """The root s, 1/s, of rho s² + k² G(s) = 0 that rings, and the top's velocity over its initial value."""
    polynomial = K**2 * G / RHO * np.array([0, 0, tau * (1 + SHARE), 1]) + np.array([tau, 1, 0, 0])
    roots = np.roots(polynomial)
    shares = roots * (1 + roots * tau) / np.polyval(np.polyder(polynomial), roots)
    return complex(roots[np.argmax(roots.imag)]), (np.exp(np.outer(t, roots)) @ shares).real


def simulation(tau: float = 1.7, maxh: float = 0.5, dt: float = DT, **options) -> nv.Simulation:
    """A layer, 1 m high, in plane strain between a rigid ground and a wall along which it slides."""
    gel = nv.prony_network(nv.LinearElastic(K_e=2000.0, G_e=G), prony=[[SHARE, tau]], of="G_inf")
    initial = nv.Initial(density=RHO, velocity=(A * sin(pi / 2 * y), 0))
    options |= {"walls": {"bottom": nv.NoSlip()}, "initial": initial, "scheme": "midpoint"}
    return nv.Simulation(channel(0.5, 1, maxh=maxh), nv.Model(material=gel), dt=dt, **options)


def main(directory: str = "results/gel", until: float = 30.0, **options) -> dict[str, tuple]:
    (fig, (axes,)), results = figure(1, 3, (13, 3.6)), {}
    for (name, tau), axis in zip(TIMES.items(), axes, strict=True):
        run, values = simulation(tau, **options), [1.0]
        while run.t < until - 0.5 * run.dt:
            run.advance()
            values.append(run.fields["velocity"](run.mesh(0.1, 1.0))[0] / A)
        s, theory = exact(tau, t := run.dt * np.arange(len(values)))
        loss = np.tan(np.angle(modulus(1j * s.imag, tau)))
        results[name] = run, np.array(values), theory, loss
        axis.plot(t, values, "C0", t, theory, "k:")
        axis.plot(t, np.exp(-s.imag * loss / 2 * t), "C3--", label=f"exp(−ωt tan δ/2), tan δ = {loss:.3f}")
        axis.set(xlabel="time, s", ylabel="velocity of the top, relative", title=f"relaxes {name}: {tau} s")
        axis.legend()
    Path(directory).mkdir(parents=True, exist_ok=True)
    fig.savefig(f"{directory}/gel.png", dpi=110)
    return results


if __name__ == "__main__":
    main(*sys.argv[1:2])
