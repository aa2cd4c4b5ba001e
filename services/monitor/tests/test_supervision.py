"""A stage that ends is restarted with growing pauses; stages end with their parent process."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from zloam_monitor import cli, ending
from zloam_monitor.processes import Process, Processes
from zloam_monitor.supervision import Supervisor

#: Programs in place of a stage: one dies at once, one ends with its parent as stages do.
DIES = [sys.executable, "-c", "print('something broke'); raise SystemExit(5)"]
ENDS_WITH_PARENT = (
    "import os; os.read(int(os.environ['ZLOAM_PARENT_PIPE']), 1); open({path!r}, 'w').write('x')"
)
PATIENCE_S = 60.0


class FakeChain:
    """A chain with one stage."""

    def __init__(self, folder: Path) -> None:
        self.processes, self.folder, self.starts = Processes(), folder, 0
        self.start("mapping")

    def start(self, stage: str, log: str | None = None) -> None:
        self.starts += 1
        self.processes.start(stage, DIES, self.folder / "mapping.log")

    def until_dead(self) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while self.processes.running["mapping"].code() is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_stage_that_dies_is_started_again_with_growing_pauses(tmp_path: Path) -> None:
    chain = FakeChain(tmp_path)
    supervisor, now = Supervisor(chain), 100.0
    for pause_s in (1, 2, 4, 8, 16, 30, 30):
        chain.until_dead()
        (said,) = supervisor.look(now)
        assert (
            f"mapping ended with exit code 5 (unknown), and is started again in {pause_s} s" in said
        )
        assert "something broke" in said
        starts = chain.starts
        assert supervisor.look(now + pause_s - 0.1) == []
        assert chain.starts == starts
        now += pause_s
        assert supervisor.look(now) == []
        assert chain.starts == starts + 1
    # The restarted stage appends to its log.
    chain.until_dead()
    assert (tmp_path / "mapping.log").read_text().count("something broke") == chain.starts
    # After a long steady time the first pause applies again.
    assert "started again in 1 s" in supervisor.look(now + 61.0)[0]
    chain.processes.stop()


def test_a_stage_that_cannot_be_started_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What ends one stage, such as a lack of memory, may refuse its next start, too."""
    chain = FakeChain(tmp_path)
    supervisor = Supervisor(chain)
    chain.until_dead()
    supervisor.look(100.0)
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    with monkeypatch.context() as short:
        short.setattr(subprocess, "Popen", refuse)
        (said,) = supervisor.look(101.0)
        assert "mapping can't be started" in said
        assert said.endswith("Cannot allocate memory): next attempt in 2 s")
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors - 2  # Of the dead process.
    assert supervisor.look(102.9) == []
    assert supervisor.look(103.0) == []
    chain.until_dead()
    assert "mapping ended with exit code 5" in supervisor.look(104.0)[0]
    chain.processes.stop()


def refuse(*_: object, **__: object) -> None:
    raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))


def test_a_stage_is_started_again_though_its_log_was_removed(tmp_path: Path) -> None:
    chain = FakeChain(tmp_path)
    chain.until_dead()
    (tmp_path / "mapping.log").unlink()
    (said,) = Supervisor(chain).look(100.0)
    assert "is started again in 1 s" in said
    assert "mapping.log" in said
    chain.processes.stop()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_a_stage_ends_with_its_parent(tmp_path: Path, number: int) -> None:
    done, log = tmp_path / "done", tmp_path / "stage.log"
    stage = [sys.executable, "-c", ENDS_WITH_PARENT.format(path=str(done))]
    program = (
        "import time; from pathlib import Path; from zloam_monitor.processes import Process;"
        f"Process('x', {stage!r}, Path({str(log)!r})); print('up', flush=True); time.sleep(60)"
    )
    source = str(Path(__file__).parent.parent / "src")
    environment = {**os.environ, "PYTHONPATH": source}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment
    ) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"up\n"
        assert not done.exists()
        parent.send_signal(number)
    deadline = time.monotonic() + PATIENCE_S
    while not (done.exists() and done.read_text() == "x"):
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.05)


def wait_for_a_signal(closed: list[str]) -> None:
    with ending.handled(ending.raised):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(PATIENCE_S)
        finally:
            closed.append("yes")


def test_a_signal_ends_a_command_on_its_way_out() -> None:
    closed: list[str] = []
    with pytest.raises(ending.EndAsked, match="SIGTERM") as asked:
        wait_for_a_signal(closed)
    assert closed == ["yes"]
    assert asked.value.number == signal.SIGTERM


def test_a_hang_up_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ending.handled(ending.raised):
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_the_pipe_is_closed_with_the_process(tmp_path: Path) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        process = Process("x", DIES, tmp_path / "x.log")
        assert process.wait(PATIENCE_S) == 5
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_link_that_cannot_be_opened_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["watch", "--connect", "nonsense", "--seconds", "0.1"]) == 1
    assert "nothing answers at tcp/nonsense:7464 (" in capsys.readouterr().err
