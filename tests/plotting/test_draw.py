"""Figures show what the run folder holds, nothing else, and can be drawn whatever went wrong in the run."""

import dataclasses
import subprocess
import sys
import warnings
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS
from btr_mjx.plotting import draw as plots
from btr_mjx.plotting import rendering, robot_figure, run_figures
from btr_mjx.plotting.run_data import read_robot, read_run, read_scan
from btr_mjx.robots import Box, hexapod
from btr_mjx.runs import write_arrays, write_json, write_table

ROBOT = hexapod()


@pytest.fixture(autouse=True)
def strict():
    """No figure may warn, about empty slices, missing glyphs, layouts that do not fit or anything else."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Few pixels, to be fast."""
    write = plots.write_figure
    monkeypatch.setattr(plots, "write_figure", lambda path, figure, dpi: write(path, figure, dpi=30))


def write_run(
    folder: Path,
    unknown=("bl_5", "bl_14"),
    iterations=3,
    generations=(4, 5),
    populations=(10, 8),
    m=4,
    truth=True,
    fitness="distance",
    seed=0,
) -> Path:
    """A run folder such as `btr_mjx.coevolve` leaves it, with invented numbers."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    box = ROBOT.simulation_box.subspace(unknown)
    start, real = ROBOT.nominal_simulation[ROBOT.simulation_box.indices(unknown)], box.sample(rng)
    trials: dict[str, list] = {"f_r": [0.1], "f_s": [0.3], "iteration": [0]}
    rows, centre = [], start
    for i in range(1, iterations + 1):
        rise = np.linspace(0.5, 1.0, generations[0])[:, None]
        f = rise * rng.uniform(0.3, 2.0, (generations[0], populations[0]))
        controllers = ROBOT.controller_box.sample(rng, f.shape)
        names = np.array(ROBOT.controller_box.names)
        write_arrays(folder / f"controllers-{i:03d}.npz", {"parameters": controllers, "fitness": f, "names": names})
        best = np.sort(f[-1])[::-1][:m]
        trials["f_s"] += best.tolist()
        trials["f_r"] += (best * (1 - 0.6 / i) + rng.normal(0, 0.02, m)).tolist()
        trials["iteration"] += [i] * m
        spread = np.linspace(1.0, 0.1, generations[1])[:, None, None] / i
        shape = (generations[1], populations[1], box.n)
        simulations = box.clip(real + spread * rng.normal(0, 0.3, shape))
        delta = np.abs(simulations - real).mean(axis=2)
        names = np.array(box.names)
        archive = {"parameters": simulations, "delta_fitness": delta, "names": names}
        write_arrays(folder / f"simulations-{i:03d}.npz", archive)
        before = np.abs(centre - real).mean()
        centre = simulations.reshape(-1, box.n)[np.argmin(delta)]
        rows.append(
            {"iteration": i, "delta_before": before, "delta_after": delta.min(), "simulation": str(centre.tolist())}
        )
    write_table(folder / "iterations.csv", rows)
    number = len(trials["f_r"])
    controllers = ROBOT.controller_box.sample(rng, number)
    write_arrays(
        folder / "trials.npz", {name: np.array(x) for name, x in trials.items()} | {"controllers": controllers}
    )
    named = lambda values: dict(zip(unknown, values.tolist(), strict=True))  # noqa: E731
    result = {"fitness": fitness, "iterations": iterations, "start": named(start), "simulation": named(centre)}
    function = FITNESS_FUNCTIONS[fitness]
    result |= {"fitness_unit": function.unit, "maximise": function.maximise}
    result["space"] = {
        name: {"low": box.low[i], "high": box.high[i], "unit": box.units[i]} for i, name in enumerate(box.names)
    }
    write_json(folder / "result.json", result | {"truth": named(real) if truth else None})
    write_json(folder / "config.json", {"template": None, "duration": 1.7, "simulation_bits": 8, "fitness": fitness})
    return folder


def change(path: Path, **arrays):
    with np.load(path) as saved:
        write_arrays(path, dict(saved) | arrays)


def write_scan(folder: Path, m=6, truth=1.6, nan=False) -> Path:
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True, exist_ok=True)
    grid = np.linspace(0.4, 1.6, 25)
    delta = np.abs(grid - truth)[:, None] * rng.uniform(0.2, 1, m) * (1 + 0.3 * rng.normal(size=(25, m)))
    delta = np.abs(delta)
    if nan:
        delta[3:5, 0] = np.nan
    arrays = {"parameter": np.array("bl_14"), "grid": grid, "truth": np.array(truth), "delta": delta}
    write_arrays(folder / "scan.npz", arrays | {"delta_fitness": delta.mean(axis=1)})
    numbers = {"spearman": 0.97, "spearman_left": 0.97, "spearman_right": float("nan"), "monotonicity": 0.9}
    units = {"parameter_unit": "m", "fitness_unit": "m/s"}
    write_json(folder / "result.json", numbers | {"roughness": 1.2} | units)
    write_json(folder / "config.json", {"parameter": "bl_14", "fitness": "distance"})
    return folder


def line(figure: Figure, label: str, panel: int = 0):
    """The curve of a label that was drawn first."""
    return next(one for one in figure.axes[panel].lines if one.get_label() == label)


def lines_like(figure: Figure, example, panel: int = 0):
    """All lines of one look, in the order of drawing."""
    look = lambda one: (one.get_linestyle(), one.get_color(), one.get_marker(), one.get_linewidth())  # noqa: E731
    return [one for one in figure.axes[panel].lines if look(one) == look(example)]


@pytest.fixture
def no_gl(monkeypatch):
    """One-coloured pictures, without OpenGL."""
    grey = lambda motions, width, height, camera: [np.full((1, height, width, 3), 99, np.uint8)] * len(motions)  # noqa: E731
    monkeypatch.setattr(robot_figure, "render", grey)


@pytest.mark.usefixtures("no_gl")
def test_draw_run_writes_every_figure(tmp_path):
    paths = plots.draw_run(write_run(tmp_path))
    names = ["controller_fitness", "delta_fitness", "parameters", "sim_versus_reality", "robot"]
    assert [path.name for path in paths] == [f"{name}.png" for name in names]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert sorted(path.name for path in tmp_path.glob("*.png")) == sorted(path.name for path in paths)


def test_controller_fitness_shows_best_mean_and_trials(tmp_path):
    run = read_run(write_run(tmp_path))
    figure = run_figures.controller_fitness(run)
    best = lines_like(figure, line(figure, "best"))
    assert len(best) == 3
    for search, curve in zip(run.controllers, best, strict=True):
        np.testing.assert_array_equal(curve.get_ydata(), search.scores.max(axis=1))
    mean = lines_like(figure, line(figure, "mean"))
    np.testing.assert_allclose([curve.get_ydata() for curve in mean], [s.scores.mean(axis=1) for s in run.controllers])
    real = lines_like(figure, line(figure, "tried: in reality"))
    np.testing.assert_array_equal(np.concatenate([one.get_ydata() for one in real]), run.trials["f_r"])
    simulated = lines_like(figure, line(figure, "tried: in simulation"))
    np.testing.assert_array_equal(np.concatenate([one.get_ydata() for one in simulated]), run.trials["f_s"])
    # A trial stands after the search that found it and before the next one.
    for k in (1, 2, 3):
        assert real[k].get_xdata().min() > best[k - 1].get_xdata().max()
        assert k == 3 or real[k].get_xdata().max() < best[k].get_xdata().min()
    assert real[0].get_xdata()[0] > figure.axes[0].get_xlim()[0]
    assert real[3].get_xdata().max() < figure.axes[0].get_xlim()[1]
    assert "m/s" in figure.axes[0].get_ylabel()


def test_controller_fitness_that_is_minimised(tmp_path):
    run = read_run(write_run(tmp_path, fitness="energy_per_metre"))
    figure = run_figures.controller_fitness(run)
    np.testing.assert_array_equal(line(figure, "best").get_ydata(), run.controllers[0].scores.min(axis=1))
    assert "J/m" in figure.axes[0].get_ylabel()


def test_delta_fitness_shows_searches_and_their_ends(tmp_path):
    run = read_run(write_run(tmp_path))
    figure = run_figures.delta_fitness_curve(run)
    for search, curve in zip(run.simulations, lines_like(figure, line(figure, "best")), strict=True):
        np.testing.assert_array_equal(curve.get_ydata(), search.scores.min(axis=1))
    before, after = line(figure, "before the search"), line(figure, "after the search")
    np.testing.assert_array_equal(before.get_ydata(), run.iterations["delta_before"])
    np.testing.assert_array_equal(after.get_ydata(), run.iterations["delta_after"])
    assert figure.axes[0].get_yscale() == "log"


def test_delta_of_exactly_zero_is_visible(tmp_path):
    write_run(tmp_path)
    with np.load(tmp_path / "simulations-003.npz") as saved:
        delta = saved["delta_fitness"].copy()
    delta[-1, 0] = 0.0
    change(tmp_path / "simulations-003.npz", delta_fitness=delta)
    figure = run_figures.delta_fitness_curve(read_run(tmp_path))
    axes = figure.axes[0]
    assert axes.get_yscale() == "symlog"
    assert axes.get_ylim()[0] <= 0
    assert lines_like(figure, line(figure, "best"))[2].get_ydata()[-1] == 0


@pytest.mark.parametrize("truth", [True, False])
def test_limb_lengths(tmp_path, truth):
    run = read_run(write_run(tmp_path, truth=truth))
    figure = run_figures.parameter_values(run)
    assert len(figure.axes) == 2
    for i, axes in enumerate(figure.axes):
        cloud = axes.collections[0].get_offsets()
        members = np.concatenate([search.parameters[..., i].ravel() for search in run.simulations])
        np.testing.assert_array_equal(cloud[:, 1], members)
        curves = lines_like(figure, line(figure, "the one with the least", i), i)
        for search, curve in zip(run.simulations, curves, strict=True):
            best = search.scores.argmin(axis=1)
            np.testing.assert_array_equal(curve.get_ydata(), search.parameters[np.arange(len(best)), best, i])
        assert line(figure, "start", i).get_ydata() == run.start[i]
        assert line(figure, "identified", i).get_ydata() == run.identified[i]
        drawn = [one.get_ydata()[0] for one in axes.lines if one.get_label() == "truth"]
        assert drawn == ([run.truth[i]] if truth else [])
        assert axes.get_ylabel() == f"{run.box.names[i]} [m]"


def test_a_number_of_a_simulator_that_grew_is_written_in_words(tmp_path):
    run = read_run(write_run(tmp_path))
    names = ["bl_5", "dry_friction joint:shoulder torque"]
    grown = dataclasses.replace(run, box=Box(names, run.box.low, run.box.high, units=["m", "N m"]))
    labels = [" ".join(axes.get_ylabel().split()) for axes in run_figures.parameter_values(grown).axes]
    assert labels == ["bl_5 [m]", "dry friction at joint shoulder [N m]"]


def test_members_are_darker_the_better_they_are(tmp_path):
    run = read_run(write_run(tmp_path))
    darkness = run_figures.parameter_values(run).axes[0].collections[0].get_array()
    scores = np.concatenate([search.scores.ravel() for search in run.simulations])
    assert (np.diff(darkness[np.argsort(scores)]) < 0).all()


def test_sim_versus_reality_shows_every_trial(tmp_path):
    run = read_run(write_run(tmp_path))
    axes = run_figures.sim_versus_reality(run).axes[0]
    for number, label in enumerate(["first controller $c_0$", "iteration 1", "iteration 2", "iteration 3"]):
        points = next(one for one in axes.lines if one.get_label() == label)
        rows = run.trials["iteration"] == number
        np.testing.assert_array_equal(points.get_xdata(), run.trials["f_s"][rows])
        np.testing.assert_array_equal(points.get_ydata(), run.trials["f_r"][rows])
    assert axes.get_xlim() == axes.get_ylim()


@pytest.mark.usefixtures("no_gl")
@pytest.mark.parametrize(
    "shape",
    [
        {"iterations": 1, "generations": (1, 1), "m": 1},
        {"iterations": 1, "generations": (1, 1), "unknown": ("bl_3",), "truth": False},
        {"iterations": 19, "generations": (1, 2), "unknown": ROBOT.simulation_box.names[:5]},
        {"unknown": ROBOT.simulation_box.names, "iterations": 2, "generations": (3, 60)},
    ],
)
def test_runs_of_any_shape(tmp_path, shape):
    assert len(plots.draw_run(write_run(tmp_path, **shape))) == 5


@pytest.mark.usefixtures("no_gl")
def test_diverged_generations_and_failed_trials(tmp_path):
    write_run(tmp_path)
    for name, score in (("controllers", "fitness"), ("simulations", "delta_fitness")):
        with np.load(tmp_path / f"{name}-002.npz") as saved:
            values = saved[score].copy()
        values[1] = np.nan
        values[2, 1:] = np.nan
        change(tmp_path / f"{name}-002.npz", **{score: values})
    with np.load(tmp_path / "simulations-003.npz") as saved:
        change(tmp_path / "simulations-003.npz", delta_fitness=np.full_like(saved["delta_fitness"], np.nan))
    with np.load(tmp_path / "trials.npz") as saved:
        f_r = saved["f_r"].copy()
    f_r[[0, 2]] = np.nan
    change(tmp_path / "trials.npz", f_r=f_r)
    run = read_run(tmp_path)
    best = lines_like(figure := run_figures.controller_fitness(run), line(figure, "best"))[1].get_ydata()
    assert np.isnan(best).tolist() == [False, True, False, False]
    assert "2 of 13 trials failed" in run_figures.sim_versus_reality(run).axes[0].get_title(loc="left")
    assert len(plots.draw_run(tmp_path)) == 5


@pytest.mark.usefixtures("no_gl")
def test_nothing_finite_at_all(tmp_path):
    write_run(tmp_path, iterations=1)
    for name, score in (("controllers", "fitness"), ("simulations", "delta_fitness")):
        with np.load(tmp_path / f"{name}-001.npz") as saved:
            change(tmp_path / f"{name}-001.npz", **{score: np.full_like(saved[score], np.nan)})
    change(tmp_path / "trials.npz", f_r=np.full(5, np.nan))
    write_table(tmp_path / "iterations.csv", [{"iteration": 1, "delta_before": np.nan, "delta_after": np.nan}])
    assert len(plots.draw_run(tmp_path)) == 5


@pytest.mark.parametrize("nan", [False, True])
def test_scan(tmp_path, nan):
    data = read_scan(write_scan(tmp_path, nan=nan))
    axes = run_figures.scan_curve(data).axes[0]
    thin = [one for one in axes.lines if one.get_linewidth() < 1]
    np.testing.assert_array_equal(np.stack([one.get_ydata() for one in thin], axis=1), data.delta)
    thick = next(one for one in axes.lines if one.get_linewidth() > 2)
    np.testing.assert_array_equal(thick.get_ydata(), data.delta_fitness)
    np.testing.assert_array_equal(thick.get_xdata(), data.grid)
    assert next(one for one in axes.lines if one.get_label() == "truth").get_xdata()[0] == 1.6
    caption = axes.get_title(loc="left")
    assert "0.97" in caption
    assert "nan" not in caption.lower()
    assert [path.name for path in plots.draw_folder(tmp_path)] == ["scan.png"]


def test_style_is_applied_and_put_back(tmp_path):
    matplotlib.use("agg")  # otherwise the first look at the default backend counts as a change
    before = matplotlib.rcParams.copy()
    with plots.style():
        assert matplotlib.rcParams["axes.spines.top"] is False
    plots.draw_scan(write_scan(tmp_path))
    assert matplotlib.rcParams == before


def test_unfinished_run_is_refused(tmp_path):
    write_run(tmp_path)
    (tmp_path / "result.json").unlink()
    with pytest.raises(InputError, match="--resume"):
        plots.draw_run(tmp_path)
    with pytest.raises(InputError, match="not a run folder"):
        plots.draw_run(tmp_path / "nowhere")


@pytest.mark.usefixtures("no_gl")
def test_a_template_that_is_gone_costs_one_picture_only(tmp_path, capsys):
    write_run(tmp_path, iterations=1)
    write_json(tmp_path / "config.json", {"template": str(tmp_path / "gone.xml"), "duration": 1.7})
    assert len(plots.draw_run(tmp_path)) == 4
    assert "gone.xml" in capsys.readouterr().err


def test_where_nothing_renders_all_other_figures_are_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    rendering.working_backend.cache_clear()
    assert len(plots.draw_run(write_run(tmp_path, iterations=1))) == 4
    rendering.working_backend.cache_clear()
    assert capsys.readouterr().err.splitlines() == ["no pictures of robots: MUJOCO_GL=disable"]


def test_a_figure_that_fails_costs_one_line(tmp_path, monkeypatch, capsys):
    def fails(data):
        raise ZeroDivisionError("of a bug")

    monkeypatch.setattr(run_figures, "scan_curve", fails)
    assert plots.draw_scan(write_scan(tmp_path)) == []
    assert capsys.readouterr().err.splitlines() == ["no scan.png: ZeroDivisionError: of a bug"]


def test_morphologies_have_the_lengths_of_the_run(tmp_path, monkeypatch):
    run = read_run(write_run(tmp_path))
    seen = []

    def render(motions, width, height, camera):
        seen.extend(model for model, _ in motions)
        return [np.zeros((1, height, width, 3), np.uint8)] * len(motions)

    monkeypatch.setattr(robot_figure, "render", render)
    figure = robot_figure.morphologies(read_robot(tmp_path), run)
    assert [axes.get_title() for axes in figure.axes] == ["nominal", "identified", "reality"]
    for model, values in zip(seen, [run.start, run.identified, run.truth], strict=True):
        lengths = [2 * model.geom(name).size[1] for name in ("b5", "b14")]
        np.testing.assert_allclose(lengths, values, atol=1e-9)
        blue = np.isclose(model.geom_rgba, robot_figure.UNKNOWN).all(axis=1)
        coloured = [model.geom(i).name for i in np.flatnonzero(blue)]
        assert coloured == ["b5", "b14"]


def test_importing_plots_loads_neither_matplotlib_nor_gl():
    loaded = "[m for m in ('matplotlib', 'btr_mjx.plotting.rendering') if m in sys.modules]"
    code = f"import sys, btr_mjx.plotting.draw; print({loaded})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[]"
