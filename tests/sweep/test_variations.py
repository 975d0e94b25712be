"""Variations: their syntax, their combinations, and the names of their runs."""

import pytest

from ngvisco.sweep.variations import SweepError, Variation, combinations


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("material.G_e=1,2.5,5e3", ("1", "2.5", "5e3")),
        ("time.scheme=euler, midpoint", ("euler", "midpoint")),
        ("loads.0.g=[0, -1],[0, -2]", ("[0, -1]", "[0, -2]")),
        ('initial.velocity=["max(x, y)", "0"],["0", "x"]', ('["max(x, y)", "0"]', '["0", "x"]')),
        ("time.dt='10 yr','1,5'", ("'10 yr'", "'1,5'")),
        ("initial.density=max(x,y),2", ("max(x,y)", "2")),
    ],
)
def test_commas_within_brackets_and_quotes_do_not_separate_values(text, values):
    assert Variation.parse(text) == Variation(text.partition("=")[0], values)


@pytest.mark.parametrize(
    "text",
    ["material.G_e", "=1,2", "material.=1", "a.b=", "a.b=1,,2", "a.b=1,1", "a.b=[1,2", "a.b=1],2", "a='1"],
)
def test_an_invalid_list_of_values_is_refused(text):
    with pytest.raises(SweepError, match=r"--vary"):
        Variation.parse(text)


def test_all_combinations_are_made_and_the_last_key_varies_fastest():
    found = combinations([Variation("material.G_e", ("1", "2")), Variation("time.dt", ("0.1", "0.2"))])
    assert [c.name for c in found][:2] == ["material.G_e=1,time.dt=0.1", "material.G_e=1,time.dt=0.2"]
    assert found[3].settings == ("material.G_e=2", "time.dt=0.2")
    assert found[3].values == {"material.G_e": "2", "time.dt": "0.2"} and len(found) == 4


def test_an_empty_or_repeated_variation_is_refused():
    for variations in ([], [Variation("a", ("1",)), Variation("a", ("2",))]):
        with pytest.raises(SweepError):
            combinations(variations)


def test_names_of_runs_are_valid_on_any_file_system_and_distinct():
    values = ("sin(x)/2", "sin(x)*2", "x" * 300, "x" * 301)
    names = [c.name for c in combinations([Variation("initial.density", values)])]
    assert len(set(names)) == 4
    assert all(len(name) < 120 and not set(name) & set('/\\:*?"<>| ') for name in names)
