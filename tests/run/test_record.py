"""``record``: the files that it writes, and invalid arguments, which it refuses before the run."""

from support import small_run

import ngvisco as nv


class Counter:
    def __init__(self):
        self.calls = []

    def start(self, simulation):
        self.calls.append("start")

    def step(self, simulation, row):
        self.calls.append(row["step"])

    def finish(self, simulation):
        self.calls.append("finish")


def simulation(observers=()):
    return small_run(1, loads=[nv.Gravity((0, -1))], observers=observers)


def test_record_writes_files_and_pictures_and_does_not_change_the_observers(tmp_path, capsys):
    counter = Counter()
    run = simulation([counter])
    show = {"speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)", "J less 1": "J - 1"}
    ledger = nv.record(run, tmp_path, 0.04, every=1, checkpoints=1, show=show)
    assert ledger is run.ledger and run.observers == [counter]
    assert counter.calls == ["start", 1, 2, "finish"]
    for file in ("ledger.csv", "run.h5", "vtk/fields.pvd"):
        assert (tmp_path / file).stat().st_size > 0
    for picture in ("energies.png", "fields.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    again = simulation()
    again.restore(tmp_path / "run.h5")
    assert again.number == 2 and again.run(0.06).column("kinetic")[-1] > ledger.column("kinetic")[-1]
    assert f"results in {tmp_path}" in capsys.readouterr().out


def test_record_without_expressions_draws_energies_only(tmp_path):
    nv.record(simulation(), tmp_path, 0.02)
    assert (tmp_path / "energies.png").exists() and not (tmp_path / "fields.png").exists()
