"""Journal: stored results are reused for identical jobs only; an interrupted search resumes bit-identically."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from gap_arm import LIBRARY, QUICK, arm, command, damped, dataset

from btr_mjx.errors import Interrupted
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import identify
from btr_mjx.gap.results import as_result
from btr_mjx.gap.simulate import Command, Counter, Journal, Segments, World, run_in_threads, simulate


def segments(seed: int = 0) -> Segments:
    rng = np.random.default_rng(seed)
    sent = command(rng)
    start = rng.normal(size=(3, 2))
    return Segments(np.zeros(3), start, np.zeros((3, 2)), np.array([0.0, 0.02, 0.05]), (sent,), np.zeros(3, int))


def test_stored_results_are_reused(tmp_path: Path) -> None:
    jobs = [(World.of(arm()), segments())]
    first = Journal(tmp_path)
    states = simulate(jobs, counter=first)
    simulate(jobs, timestep=1e-3, counter=first)
    plain = Counter()
    np.testing.assert_array_equal(simulate(jobs, counter=plain)[0], states[0])
    assert first.steps == 3 * plain.steps  # 2 ms steps, then twice as many

    marked = sorted(tmp_path.glob("*.npz"))
    assert len(marked) == 2
    before = marked[0].stat().st_mtime_ns
    again = Journal(tmp_path)
    np.testing.assert_array_equal(simulate(jobs, counter=again)[0], states[0])
    assert again.steps == plain.steps
    assert marked[0].stat().st_mtime_ns == before
    again.close()
    assert not tmp_path.exists()


def other_model() -> list:
    model = arm()
    model.dof_damping[0] += 1e-9
    return [(World.of(model), segments())]


def other_command() -> list:
    delay = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}["actuator_delay@all"]
    return [(delay.apply(World.of(arm()), [1e-3]), segments())]


def rubbing(coefficient: float) -> list:
    friction = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}["load_friction@joint:elbow"]
    return [(friction.apply(World.of(arm()), [coefficient]), segments())]


def pushed(law) -> list:
    world = World.of(arm())
    world.laws.append(law)
    return [(world, segments())]


class Push:
    fields = ()

    def __init__(self, size: float, how: str = "object") -> None:
        self.size, self.how = np.array([size, 0.0]), how

    def __call__(self, rows) -> None:
        rows.qfrc_applied[:] += self.size


def closed_over(size: float):
    push = Push(size)

    def law(rows) -> None:
        push(rows)

    vars(law)["fields"] = ()
    return law


class Slotted:
    __slots__ = ("size",)
    fields = ()

    def __init__(self, size: float) -> None:
        self.size = size

    def __call__(self, rows) -> None:
        rows.qfrc_applied[:] += self.size


@pytest.mark.parametrize(
    ("law", "known"),
    [
        (rubbing, True),
        (lambda size: pushed(Push(size)), True),
        (lambda size: pushed(closed_over(size)), True),
        (lambda size: pushed(Slotted(size)), False),
    ],
    ids=["friction", "object", "closure", "whatever"],
)
def test_laws_with_other_values_are_not_matched(tmp_path: Path, law, known: bool) -> None:
    """All values that a law holds are part of the key."""
    first = simulate(law(0.2), counter=Journal(tmp_path))[0]
    again = Journal(tmp_path)
    other = simulate(law(0.3), counter=again)[0]
    np.testing.assert_array_equal(other, simulate(law(0.3))[0])
    assert np.abs(other - first).max() > 1e-6
    assert (again.lookup(law(0.2), None)[0] is not None) is known
    np.testing.assert_array_equal(simulate(law(0.2), counter=again)[0], first)


def test_results_of_other_code_are_discarded(tmp_path: Path) -> None:
    """User-defined effects may be edited between interruption and resume."""
    jobs = [(World.of(arm()), segments())]
    simulate(jobs, counter=Journal(tmp_path, code=b"before"))
    assert Journal(tmp_path, code=b"before").lookup(jobs, None)[0] is not None
    assert Journal(tmp_path, code=b"after").lookup(jobs, None)[0] is None
    assert not list(tmp_path.glob("*.npz"))


@pytest.mark.parametrize(
    "jobs", [other_model, other_command, lambda: [(World.of(arm()), segments(1))]], ids=["model", "command", "start"]
)
def test_other_jobs_are_not_matched(tmp_path: Path, jobs) -> None:
    same = [(World.of(arm()), segments())]
    simulate(same, counter=Journal(tmp_path))
    again = Journal(tmp_path)
    np.testing.assert_array_equal(simulate(jobs(), counter=again)[0], simulate(jobs())[0])
    assert len(list(tmp_path.glob("*.npz"))) == 2


@pytest.mark.parametrize(
    "edit",
    [
        lambda size: partial(Command.shifted, delay=size),
        lambda size: partial(Command.filtered, time_constant=np.array([size, 0.0])),
        lambda size: partial(Command.rate_limited, rate=size),
        lambda size: lambda command: command.shifted(size).filtered(size),
    ],
    ids=["delay", "lag", "rate", "closure"],
)
def test_edits_of_commands_are_matched_by_their_numbers(tmp_path: Path, edit) -> None:
    def jobs(size: float) -> list:
        world = World.of(arm())
        world.command_edits.append(edit(size))
        return [(world, segments())]

    simulate(jobs(0.02), counter=Journal(tmp_path))
    assert Journal(tmp_path).lookup(jobs(0.02), None)[0] is not None
    assert Journal(tmp_path).lookup(jobs(0.03), None)[0] is None


def test_order_of_threads_does_not_matter(tmp_path: Path) -> None:
    """Results and number of steps are the same for another order of calls."""
    questions = [[(World.of(arm()), segments(seed))] for seed in range(6)]
    first = Journal(tmp_path)
    states = run_in_threads([partial(simulate, jobs, counter=first) for jobs in questions])
    again = Journal(tmp_path)
    back = run_in_threads([partial(simulate, jobs, counter=again) for jobs in reversed(questions)])
    for ours, theirs in zip(states, reversed(back), strict=True):
        np.testing.assert_array_equal(ours[0], theirs[0])
    plain = Counter()
    for jobs in questions:
        simulate(jobs, counter=plain)
    assert first.steps == again.steps == plain.steps


def test_damaged_file_is_simulated_again(tmp_path: Path) -> None:
    jobs = [(World.of(arm()), segments())]
    states = simulate(jobs, counter=Journal(tmp_path))[0]
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:-100])
    np.testing.assert_array_equal(simulate(jobs, counter=Journal(tmp_path))[0], states)


def test_interrupted_search_resumes_bit_identically(tmp_path: Path) -> None:
    """Interrupted twice, in the first round and late."""
    made = dataset(damped, seed=1, fit=2, test=1)

    def search(journal: Journal | None, note=lambda word: None):
        return identify(made, LIBRARY[:2], max_effects=1, options=QUICK, progress=note, counter=journal)

    def killed(limit: float):
        def kill(steps: int) -> None:
            if steps > limit:
                raise Interrupted("stop", 15)

        return kill

    whole = search(None)
    simulated = []
    for share in (0.3, 0.8):
        with pytest.raises(Interrupted):
            search(Journal(tmp_path, killed(share * whole.steps)))
        simulated.append(len(list(tmp_path.glob("*.npz"))))
    assert 0 < simulated[0] < simulated[1]
    journal = Journal(tmp_path)
    resumed = search(journal)
    assert len(list(tmp_path.glob("*.npz"))) > simulated[1]
    assert journal.steps >= resumed.steps
    results = [as_result(d, made) for d in (whole, resumed)]
    for result in results:
        del result["seconds"]
    np.testing.assert_equal(results[0], results[1])
    np.testing.assert_array_equal(whole.disagreement.before, resumed.disagreement.before)
    assert [s.values(True).tolist() for s in whole.survivors] == [s.values(True).tolist() for s in resumed.survivors]


def test_what_was_computed_is_remembered_instead_of_its_simulations(tmp_path: Path) -> None:
    def compute(journal: Journal, seed: int) -> dict[str, np.ndarray]:
        return {"mean": simulate([(World.of(arm()), segments(seed))], counter=journal)[0].mean((0, 1))}

    def remembered(journal: Journal, seed: int) -> np.ndarray:
        return journal.remembered(("mean", seed), partial(compute, journal, seed))["mean"]

    first, again = Journal(tmp_path), Journal(tmp_path)
    simulate([(World.of(arm()), segments(7))], counter=first)
    before = set(tmp_path.glob("*.npz"))
    found = remembered(first, 0)
    assert before < set(tmp_path.glob("*.npz"))
    assert len(set(tmp_path.glob("*.npz")) - before) == 1
    simulate([(World.of(arm()), segments(7))], counter=again)
    np.testing.assert_array_equal(remembered(again, 0), found)
    assert again.steps == first.steps
    assert not np.array_equal(remembered(again, 1), found)
