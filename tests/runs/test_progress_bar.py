import io
import re

from btr_mjx.runs import progress_bar as progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def counts(stream):
    """The lines, without drawn bar, times and rate."""
    lines = [re.sub(r"\|.*\|", "", line).split(" [")[0] for line in stream.getvalue().splitlines()]
    return [re.sub(" +", " ", line) for line in lines]


def test_progress_is_silent_without_a_terminal(capfd):
    assert list(progress.progress(range(3), description="pairs")) == [0, 1, 2]
    with progress.progress(total=3, show=False, file=Terminal()) as bar:
        bar.update(3)
        bar.set_postfix(best=1)
    assert capfd.readouterr() == ("", "")


def test_words_without_numbers():
    stream = io.StringIO()
    with progress.progress(total=4, description="scan", interval=0.0, show=True, file=stream) as bar:
        progress.say_progress(bar, "waiting for trial 3", numbers=False)
        progress.say_progress(bar, "scan")
        bar.update(4)
    assert "waiting for trial 3" in stream.getvalue().splitlines()
    assert counts(stream)[-1] == "scan: 100% 4/4"


def test_progress_lines():
    stream = io.StringIO()
    with progress.progress(
        total=4000, description="scan", unit="pairs", unit_scale=True, show=True, file=stream
    ) as bar:
        for i in range(4):
            bar.update(1000)
            bar.set_description(f"scan {i}")
    # The beginning and the end: it took less than an interval.
    assert counts(stream) == ["scan: 0% 0.00/4.00k", "scan 3: 100% 4.00k/4.00k"]
    assert "pairs/s" in stream.getvalue().splitlines()[1]
    stream = io.StringIO()
    for _ in progress.progress(range(2), description="outer", show=True, interval=0, file=stream):
        for _ in progress.progress(iter(range(2)), description="inner", show=True, interval=0, file=stream):
            pass
    assert not set(stream.getvalue()) & set("\r\x1b")
    assert "inner: 2it" in counts(stream)
    assert counts(stream)[-1] == "outer: 100% 2/2"


def test_progress_bar_on_a_terminal():
    stream = Terminal()
    with progress.progress(total=2, description="outer", file=stream) as outer:
        for _ in progress.progress(range(2), description="inner", file=stream):
            outer.update()
    assert "\r" in stream.getvalue()
    assert "outer: 100%" in stream.getvalue()
