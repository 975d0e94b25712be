"""A tangent is renewed when a new one would have saved as many directions as a renewal costs."""

import pytest
from support import assert_goes_on, swirling

import ngvisco as nv
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.split.solver import Split
from ngvisco.solver.split.wear import Wear

COST = 30


def renewals(directions, new):
    """Numbers of the increments after which tangents are renewed.

    Increment n takes ``directions[n]`` with an old tangent and ``new[n]`` with a new one."""
    wear, found, is_new = Wear(COST), [], True
    for number, (old, of_new) in enumerate(zip(directions, new, strict=True)):
        wear.count(of_new if is_new else old)
        is_new = wear.is_dear(1.0)
        if is_new:
            found.append(number)
            wear.renew()
    return found


def test_a_tangent_is_not_renewed_if_this_saves_no_directions():
    """The counts of directions are from a step on 50,552 tetrahedra, in which six new tangents saved no
    direction."""
    directions = [21, 24, 23, 23, 24, 14, 14]
    assert renewals(directions, directions) == []


def test_an_easy_first_increment_causes_at_most_one_useless_renewal():
    directions = [8, *10 * [24]]
    assert len(renewals(directions, directions)) == 1


def test_a_tangent_is_renewed_when_its_extra_directions_cost_as_much_as_a_renewal():
    assert renewals(10 * [20], 10 * [10]) == [4, 9]
    assert renewals(10 * [13], 10 * [10]) == []


def test_renewals_cost_at_most_twice_the_least_cost():
    """With an old tangent each increment takes one direction more than the increment before."""
    increments = 200
    wear, age, directions, count = Wear(COST), 0, 0, 0
    for _ in range(increments):
        wear.count(10 + age)
        directions, age = directions + age, age + 1
        if wear.is_dear(1.0):
            wear.renew()
            count, age = count + 1, 0
    least = min((increments // n) * (n * (n - 1) // 2 + COST) for n in range(1, 40))
    assert directions + COST * count <= 2 * least


def test_a_slow_tangent_is_renewed_before_the_iteration_has_become_long():
    """Increments by a new tangent contract by 1e-3. A tangent costs 30 directions, and an increment with its
    residual costs 8."""
    wear = Wear(COST)
    wear.count(2)
    wear.rate(1e-3, is_new=True)
    assert not wear.is_dear(1e8)  # the tangent is new
    wear.rate(0.1, is_new=False)
    assert wear.is_dear(1e6)  # the old tangent takes 6 increments, a new one 2
    assert not wear.is_dear(1e5)  # the old tangent takes 5 increments, a new one 1.7
    wear.rate(1.5, is_new=False)
    assert not wear.is_dear(1e6)  # a rate above 1 is divergence, which other code handles
    wear.renew()
    wear.rate(0.05, is_new=True)
    wear.rate(0.1, is_new=False)
    assert not wear.is_dear(1e6)  # the old tangent takes 6 increments, a new one 4.6
    wear.rate(0.0, is_new=True)  # this is the first increment of the next step
    assert not wear.is_dear(1e6)


def test_an_increment_by_a_worn_tangent_is_computed_again_before_the_next_residual(monkeypatch):
    """In this test every contraction counts as slow. If an increment shows that the tangent is worn, the
    tangent is renewed before another residual is computed. The contraction by the old tangent does not count
    for the new tangent."""
    worn = SplitOptions(renewed_above=1e9, stale_above=1e-12)
    run, events = swirling(0.3, 0.02, solver="split", newton=nv.NewtonOptions(split=worn)), []

    def note(name, letter):
        kept = getattr(Split, name)

        def noted(*given, **named):
            events.append(letter)
            return kept(*given, **named)

        monkeypatch.setattr(Split, name, noted)

    for name, letter in (("evaluated", "E"), ("solved", "S"), ("renew", "R")):
        note(name, letter)
    run.advance()
    increments = "".join(events).split("E")[1:]
    assert increments[:3] == ["RS", "SRS", "SRS"]
    assert set(increments[3:]) <= {"SRS", "S"}
    assert increments[-1] == "S"  # a tangent is not renewed for the last increments


def test_counts_of_directions_are_restored_from_a_checkpoint():
    wear, again = Wear(COST), Wear(COST)
    wear.rate(1e-3, is_new=True)
    for directions in (10, 25, 20):
        wear.count(directions)
    again.load_state_dict(wear.state_dict())
    assert not again.is_dear(1.0)
    for one in (wear, again):
        one.count(16)
        assert one.is_dear(1.0)
    for one in (wear, again):
        one.renew()
        one.count(2)
        one.rate(0.1, is_new=False)
        assert one.is_dear(1e6)
    again.load_state_dict({})  # a checkpoint of an older version
    again.count(40)
    assert not again.is_dear(1.0)


@pytest.mark.long
@pytest.mark.ci
def test_a_resumed_run_renews_its_tangent_at_the_same_steps(tmp_path):
    """The steps are so short that one tangent serves several of them."""
    newton = nv.NewtonOptions(split=SplitOptions(renewed_after=1))

    def run(observers):
        return swirling(
            0.3,
            0.001,
            observers=observers,
            hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4),
            solver="split",
            newton=newton,
        )

    assert_goes_on(run, tmp_path / "run.h5", 0.006, 2, 3, 4, 5)
