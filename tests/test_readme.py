"""The README's programs run as they are printed there."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).resolve().parents[1] / "README.md").read_text()


@pytest.mark.parametrize("name", re.findall(r"<!-- (\w+): a test executes", README))
def test_program_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(rf"<!-- {name}: a test.*?```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    exec(compile(block, f"README.md ({name})", "exec"), names)
    assert abs(names["run"].ledger.column("closure_relative")).max() <= 1e-10
    assert "0" in capsys.readouterr().out


def test_hdf5_is_read_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    run, reader = blocks[0], next(block for block in blocks if "coefficients =" in block)
    names = {}
    exec(run, names)
    exec(reader, names)
    assert names["unit"] == "J" and len(names["closure"]) == 6
    assert len(names["coefficients"]) == names["run"].rothe_step.layout.space.ndof


def test_every_ledger_column_is_explained():
    import ngvisco as nv
    from ngvisco.geometries import box

    model = nv.Model(material=nv.NeoHookean(K_e=1.0, G_e=1.0, epsilon=1.0))
    columns = nv.Simulation(box((1, 1), maxh=1), model, dt=1.0).ledger.columns
    assert all(f"`{column}`" in README for column in columns)


def test_commands_name_existing_files():
    for path in re.findall(r"\]\(([\w./]+\.(?:md|png))\)", README):
        assert (Path(__file__).resolve().parents[1] / path).is_file(), path


def test_table_of_materials_is_the_generated_one():
    from ngvisco.physics.materials.catalogue import table

    assert table().strip() in README
