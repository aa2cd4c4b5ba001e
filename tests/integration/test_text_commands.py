"""Every command of README.md and deploy/README.md, copied from the text, ends as the text says.

The commands run in a folder that looks like a checkout with built programs, in a network namespace
of its own: ports are those of the text, and no other robot of this machine is found.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import tarfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.acceptance.decoded import udp_payloads
from tests.integration import text_commands as texts
from tests.integration.conftest import ROOT, Capture
from tests.integration.text_commands import BesideRun, LiveRun, Runs
from tests.recordings import variants
from tests.recordings.test_folders import written

PATIENCE_S = 280.0
#: a `make` that treats the target build as up to date
MAKE = '#!/bin/sh\nexec /usr/bin/make -o build "$@"\n'
OUSTER = "data/ouster/OS-1-128_v2.3.0_1024x10_lb_n3"
KITTI = "data/hdl64e_drive/velodyne.tar.xz"
KITTI_SCANS = 20
#: how long the sensor that begins late sends, and the time its last sweeps need after the last
#: packet
SENSOR_S, AFTER_S = 4.0, 2.0
SHOWN = {text: texts.commands((ROOT / text).read_text()) for text in texts.TEXTS}


@dataclass(frozen=True)
class Checkout:
    """A folder as after `git clone` and `make build`, and a network namespace of its own."""

    folder: Path
    #: process id that keeps the network namespace alive
    keeper: int

    def inside(self, *command: str) -> list[str]:
        target = ("--target", str(self.keeper), "--user", "--net", "--preserve-credentials")
        return ["nsenter", *target, *command]

    def start(self, command: str) -> subprocess.Popen[str]:
        """Starts the command in a process group of its own, as a shell does, so that it can be
        interrupted alone."""
        return subprocess.Popen(
            self.inside("bash", "-c", command),
            cwd=self.folder,
            env=self.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def environment(self) -> dict[str, str]:
        """The environment of a user, without the settings of the tests."""
        path = f"{self.folder}/.made:{self.folder}/bin:{os.environ['PATH']}"
        kept = {n: v for n, v in os.environ.items() if not n.startswith(("ZLOAM_", "MAKE"))}
        kept.pop("PYTHONPATH", None)
        build = str(self.folder / "build/release")
        return {**kept, "PATH": path, "ZLOAM_BUILD": build, "PYTHONUNBUFFERED": "1"}


@contextlib.contextmanager
def own_network() -> Iterator[int]:
    """Process id of a process in a new network namespace."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("no unshare or ip: the commands need a network of their own")
    script = "ip link set lo up && echo up && exec sleep infinity"
    with subprocess.Popen(
        ["unshare", "--user", "--map-root-user", "--net", "sh", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        if process.stdout.readline() != "up\n":
            pytest.skip(f"no network of one's own: {process.communicate()[1].strip()}")
        try:
            yield process.pid
        finally:
            process.kill()


def furnish(folder: Path, build: Path, keeper: int) -> Checkout:
    for path in ROOT.iterdir():
        if path.name not in ("build", "out", ".git"):
            (folder / path.name).symlink_to(path)
    (folder / "build").mkdir()
    (folder / "build/release").symlink_to(build)
    (folder / ".made").mkdir()
    (folder / ".made/make").write_text(MAKE)
    (folder / ".made/make").chmod(0o755)
    return Checkout(folder, keeper)


@pytest.fixture
def checkout(tmp_path: Path, build: Path) -> Iterator[Checkout]:
    folder = tmp_path / "zenoh-loam"
    folder.mkdir()
    with own_network() as keeper:
        yield furnish(folder, build, keeper)


@dataclass(frozen=True)
class Given:
    """Prepares what a command needs before it runs, in the command's folder."""

    folder: Path
    build: Path
    capture: Capture
    #: folder of the real recordings
    shared: Callable[[], Path]

    def put(self, name: str) -> None:
        makers: dict[str, Callable[[], None]] = {
            "drive.pcap": lambda: self._link("drive.pcap", self.capture.pcap),
            "base.tum": lambda: self._link("base.tum", self.capture.truth_base),
            "drive.mcap": self._bag,
            "clouds": self._clouds,
            "packets.bin": self._payloads,
            "ouster": self._ouster,
            "velodyne": self._velodyne,
            "my.yaml": lambda: self._link("my.yaml", ROOT / "deploy/robots/vlp16-outdoor.yaml"),
        }
        makers[name]()

    def _link(self, name: str, path: Path) -> None:
        (self.folder / name).symlink_to(path)

    def _bag(self) -> None:
        scans = variants.decoded(self.build, self.capture.pcap, self.folder)
        bag = self.folder / "bag"
        variants.write(bag, scans, variants.PLAIN, variants.CONTAINERS[6])
        self._link("drive.mcap", next(bag.glob("*.mcap")))

    def _clouds(self) -> None:
        written(
            self.folder / "clouds", variants.decoded(self.build, self.capture.pcap, self.folder)
        )

    def _payloads(self) -> None:
        payloads = (data for _, data in udp_payloads(self.capture.pcap) if len(data) == 1206)
        (self.folder / "packets.bin").write_bytes(b"".join(payloads))

    def _ouster(self) -> None:
        for kind in ("pcap", "json"):
            self._link(f"drive.{kind}", self.shared() / f"{OUSTER}.{kind}")

    def _velodyne(self) -> None:
        scans = self.folder / "path/to/velodyne"
        scans.mkdir(parents=True)
        with tarfile.open(self.shared() / KITTI) as tar:
            names = sorted(n for n in tar.getnames() if n.endswith(".bin"))[:KITTI_SCANS]
            for name in names:
                (scans / Path(name).name).write_bytes(tar.extractfile(name).read())


@pytest.fixture
def given(
    checkout: Checkout, build: Path, capture: Capture, request: pytest.FixtureRequest
) -> Given:
    return Given(checkout.folder, build, capture, lambda: request.getfixturevalue("shared"))


def judged(kind: type[Runs]) -> list[object]:
    """The commands of exactly this kind as test parameters, slow ones marked."""
    return [
        pytest.param(command, each, id=command, marks=[pytest.mark.slow] if each.slow else [])
        for command, each in texts.COMMANDS.items()
        if type(each) is kind
    ]


def meant(command: str, expected: Runs) -> str:
    """The command with its placeholders replaced."""
    for name, value in expected.meaning:
        command = re.sub(rf"\b{name}\b", value, command)
    return command


def assert_left(folder: Path, expected: Runs) -> None:
    missing = [n for n in expected.leaves if not (folder / n).is_file()]
    assert not missing
    assert [n for n in expected.leaves if (folder / n).stat().st_size == 0] == []


def test_each_command_of_the_texts_is_judged() -> None:
    new = {text: [c for c in SHOWN[text] if c not in texts.COMMANDS] for text in SHOWN}
    assert new == {text: [] for text in texts.TEXTS}


def test_each_judged_command_is_in_a_text() -> None:
    shown = {command for commands in SHOWN.values() for command in commands}
    assert sorted(texts.COMMANDS.keys() - shown) == []


@pytest.mark.parametrize("text", texts.TEXTS)
def test_listings_say_their_language(text: str) -> None:
    languages = {language for language, _ in texts.listings((ROOT / text).read_text())}
    assert texts.SHELL in languages
    assert languages <= {texts.SHELL, *texts.OTHERS}


def test_a_new_command_is_found() -> None:
    text = "Do `make tea`, or a `noun`.\n```sh\nbrew \\\n  --strong   # at five\n# nothing\n```\n"
    assert texts.commands(text) == ["brew --strong", "make tea"]


@pytest.mark.parametrize(("command", "expected"), judged(Runs))
def test_it_runs_as_shown(command: str, expected: Runs, checkout: Checkout, given: Given) -> None:
    for name in expected.needs:
        given.put(name)
    with checkout.start(meant(command, expected)) as process:
        said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, said
    assert re.search(expected.says, said), said
    assert_left(checkout.folder, expected)


@dataclass
class Robot:
    """A run in the checkout's network, and its output."""

    process: subprocess.Popen[str]
    said: str = ""

    def until(self, pattern: str) -> None:
        for line in self.process.stdout:
            self.said += line
            if re.search(pattern, self.said):
                return
        raise AssertionError(f"it never said {pattern}:\n{self.said}")

    def interrupt(self) -> None:
        """Interrupts the whole process group, as Ctrl-C does."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGINT)
        self.said += self.process.communicate(timeout=60.0)[0]


@pytest.fixture(scope="module")
def beside(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Checkout]:
    """A checkout in which a drive runs at half the sensor's pace, longer than the commands take on
    a busy machine."""
    with own_network() as keeper:
        checkout = furnish(tmp_path_factory.mktemp("beside"), build, keeper)
        length = "--simulate=--duration --simulate=60"
        with checkout.start(f"bin/zloam demo --rate 0.5 {length}") as process:
            robot = Robot(process)
            robot.until(r"poses/s")
            yield checkout
            robot.interrupt()


@pytest.mark.parametrize(("command", "expected"), judged(BesideRun))
def test_it_reaches_a_robot_as_shown(command: str, expected: Runs, beside: Checkout) -> None:
    endless = "subscribe.py" in command
    with beside.start(meant(command, expected)) as process:
        if endless:
            robot = Robot(process)
            robot.until(expected.says)
            robot.interrupt()
            return
        said, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0, said
    assert re.search(expected.says, said), said
    assert_left(beside.folder, expected)


@pytest.mark.parametrize(("command", "expected"), judged(LiveRun))
def test_it_runs_on_a_sensor_as_shown(
    command: str, expected: LiveRun, checkout: Checkout, given: Given
) -> None:
    given.put("drive.pcap")
    code = "from tests.acceptance.live import send; from pathlib import Path; "
    code += f"send(Path('drive.pcap'), 2368, {SENSOR_S})"
    with checkout.start(command) as process:
        robot = Robot(process)
        robot.until(r"no packets on UDP 2368")
        sender = checkout.inside(".venv/bin/python", "-c", code)
        environment = {**checkout.environment(), "PYTHONPATH": "services/monitor/src:."}
        subprocess.run(sender, cwd=checkout.folder, env=environment, check=True)
        time.sleep(AFTER_S)
        robot.interrupt()
    assert re.search(expected.says, robot.said), robot.said
    assert_left(checkout.folder, expected)
