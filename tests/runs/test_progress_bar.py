import io

from btr_mjx.runs import progress_bar as progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


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
    assert stream.getvalue().splitlines()[-1].startswith("scan: 100% 4/4")


def test_progress_lines():
    stream = io.StringIO()
    with progress.progress(
        total=4000, description="scan", unit="pairs", unit_scale=True, show=True, file=stream
    ) as bar:
        for _ in range(4):
            bar.update(1000)
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2  # the beginning and the end: it took less than an interval
    assert lines[0].startswith("scan: 0% 0.00/4.00k [")
    assert lines[1].startswith("scan: 100% 4.00k/4.00k [00:00<00:00, ")
    assert "pairs/s" in lines[1]
    stream = io.StringIO()
    for _ in progress.progress(range(2), description="outer", show=True, interval=0, file=stream):
        for _ in progress.progress(iter(range(2)), description="inner", show=True, interval=0, file=stream):
            pass
    assert not set(stream.getvalue()) & set("\r\x1b")
    assert [line.split(" [")[0] for line in stream.getvalue().splitlines()].count("inner: 2 it") == 2
    assert stream.getvalue().splitlines()[-1].startswith("outer: 100% 2/2")
    stream = io.StringIO()
    with progress.progress(total=2, show=True, interval=0, file=stream) as bar:
        bar.update()
        bar.set_description("late")
    assert [line.split(" [")[0] for line in stream.getvalue().splitlines()] == ["0% 0/2", "50% 1/2", "late: 50% 1/2"]


def test_progress_bar_on_a_terminal():
    stream = Terminal()
    with progress.progress(total=2, description="outer", file=stream) as outer:
        for _ in progress.progress(range(2), description="inner", file=stream):
            outer.update()
    assert "\r" in stream.getvalue()
    assert "outer: 100%" in stream.getvalue()
