"""An example of every flow rule, by its class, with stresses of order 1 to 10 Pa and rates of order 1/s."""

import ngvisco as nv

EXAMPLES: dict[str, nv.FlowRule] = {
    "linear": nv.Creep(G_m=2.0),
    "Norton, n = 1": nv.Norton(A=0.5, n=1),
    "Norton, n = 3": nv.Norton(A=0.3, n=3),
    "Norton, n = 10": nv.Norton(A=0.2, n=10),
    "Bingham": nv.Perzyna(sigma_Y=0.5, G_m=0.5),
    "Perzyna, n = 2.5": nv.Perzyna(sigma_Y=0.5, G_m=0.5, n=2.5),
    "linear hardening": nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=2.0),
    "Voce": nv.Perzyna(sigma_Y=0.5, G_m=0.5, n=2, Q=1.0, b=5.0),
    "Drucker-Prager": nv.DruckerPrager(cohesion=0.3, friction_angle=30.0, G_m=0.5),
    "Eyring": nv.Eyring(A=0.5, sigma_0=0.5),
    "activated": nv.Activated(rule=nv.Norton(A=0.3, n=3), E=1e4, theta_R=300.0, temperature=320.0),
    "WLF": nv.WLF(rule=nv.Creep(G_m=2.0), C_1=10.0, C_2=50.0, theta_R=300.0, temperature=301.0),
    "composite": nv.Composite(rules=(nv.Creep(G_m=5.0), nv.Norton(A=0.2, n=4))),
}

OF_CONFORMATION: dict[str, nv.FlowRule] = {
    "Giesekus": nv.Giesekus(G_m=2.0, alpha=0.3),
    "linear PTT": nv.PTT(G_m=2.0, epsilon=0.25),
    "exponential PTT": nv.PTT(G_m=2.0, epsilon=0.25, form="exponential"),
    "Saramito": nv.Perzyna(sigma_Y=0.3, G_m=2.0, law="conformation"),
    "Saramito, n = 2": nv.Perzyna(sigma_Y=0.3, G_m=2.0, n=2, law="conformation"),
    "power law": nv.Norton(A=0.5, n=2, law="conformation"),
}
"""Rules that read a conformation tensor or its conjugate."""
