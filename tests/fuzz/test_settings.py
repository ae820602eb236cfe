"""Settings of commands that cannot be meant: one line and exit code 2, before any file is written."""

from pathlib import Path

import pytest

from btr_mjx import coevolve, diagnose, scan
from btr_mjx.robots import hexapod


@pytest.mark.parametrize(
    ("main", "flags", "named"),
    [
        (coevolve.main, "--seed=-3", "seed"),
        (coevolve.main, "--controllers=88888888888888888888", "controllers"),
        (coevolve.main, "--simulation-generations=1000000000", "simulation_generations"),
        (coevolve.main, "--simulations=900000 --simulation-generations=900000", "trials"),
        (coevolve.main, "--noise=1e300", "noise"),
        (coevolve.main, "--noise=nan", "noise"),
        (coevolve.main, "--noise=-1", "noise"),
        (coevolve.main, "--target-delta=inf", "target_delta"),
        (coevolve.main, "--target-delta=nan", "target_delta"),
        (coevolve.main, "--duration=1e-7", "duration"),
        (coevolve.main, "--duration=nan", "duration"),
        (coevolve.main, "--duration=1e9", "duration"),
        (coevolve.main, "--marks 0.1 nan", "marks"),
        (coevolve.main, "--marks=-inf", "marks"),
        (coevolve.main, "--p-m=nan", "p_m"),
        (coevolve.main, "--controller-bits=0", "controller_bits"),
        (coevolve.main, "--max-effects=-1", "max_effects"),
        (coevolve.main, "--iterations=0", "iterations"),
        (coevolve.main, "--reality-timestep=nan --reality-engine=native", "reality_timestep"),
        (coevolve.main, "--template=/dev/zero", "device"),
        (coevolve.main, "--robot=/dev/zero", "device"),
        (scan.main, "--seed=-1", "seed"),
        (scan.main, "--grid=2000000000", "grid"),
        (scan.main, "--grid=1", "grid"),
        (scan.main, "--trials=999999999999999999999", "trials"),
        (scan.main, "--truth=nan", "nan"),
        (scan.main, "--duration=1e-5", "duration"),
        (scan.main, "--generations=99999999999", "generations"),
        (diagnose.main, "--demo --seed=-1", "seed"),
        (diagnose.main, "--demo --seed=99999999999999999999999", "seed"),
        (diagnose.main, "--demo --max-effects=0", "max_effects"),
    ],
)
def test_settings(main, flags: str, named: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([*flags.split(), "--out", "run", "--no-progress"])
    assert ended.value.code == 2
    line = capsys.readouterr().err
    assert line.startswith("error: ")
    assert line.count("\n") == 1
    assert named in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('<pid name="j{{ 8 + leg }}" joint="j{{ 8 + leg }}"/>', "", "controls"),
        ('name="b0"', 'name="trunk"', "b0"),
        ('timestep="{{ timestep }}"', 'timestep="nan"', "timestep"),
    ],
)
def test_templates_that_do_not_fit_the_hexapod(
    old: str, new: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = hexapod().template
    assert old in text
    (tmp_path / "t.xml.j2").write_text(text.replace(old, new))
    with pytest.raises(SystemExit) as ended:
        coevolve.main(["--template", "t.xml.j2", "--out", "run", "--no-progress"])
    assert ended.value.code == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
