"""The commands that README.md and deploy/README.md show, and how a test treats each.

A command of a text that is missing here fails the test, and so does a command listed here that no
text shows.
"""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass

from tests.integration.conftest import ROOT

TEXTS = ("README.md", "deploy/README.md")
#: languages of listings; only shell listings contain commands ("": drawings)
SHELL, OTHERS = "sh", {"", "json5"}
_LISTING = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r"`([^`]+)`")
_COMMENT = re.compile(r"(^|\s)#.*$")
#: beginnings of a command within a sentence: a program, or a script of the repository
_PROGRAM = re.compile(
    r"(make|docker|kubectl|pip|apt|pytest|promtool|ip|tcpdump|nft|sysctl|ulimit|"
    r"(bin/)?zloam|zloam-\w+) "
)
_ASSIGNMENT = re.compile(r"[A-Z_]+=")


@dataclass(frozen=True)
class Runs:
    """Copied from the text and run in a folder that looks like a checkout."""

    #: pattern of the output
    says: str
    #: files that the command creates
    leaves: tuple[str, ...] = ()
    #: what is prepared in the folder beforehand (test_text_commands.py)
    needs: tuple[str, ...] = ()
    #: placeholders of the text and their replacements
    meaning: tuple[tuple[str, str], ...] = ()
    slow: bool = False


@dataclass(frozen=True)
class BesideRun(Runs):
    """Run likewise, while a robot runs on this machine."""


@dataclass(frozen=True)
class LiveRun(Runs):
    """A live run, ended by Ctrl-C, on a sensor that begins to send after a while."""


@dataclass(frozen=True)
class Form:
    """Not run: only checked that the program has the words and options, and that the files
    exist."""

    tried_by: str


@dataclass(frozen=True)
class Excluded:
    """Neither run nor checked."""

    reason: str


Kind = Runs | Form | Excluded

_RESULTS = ("picture.png", "trajectory.tum", "trajectory.kitti", "map.pcd", "report.json")
DEMO = tuple(f"out/demo/{name}" for name in _RESULTS)
LIVE = ("out/run/trajectory.tum", "out/run/map.pcd")
ALL_WELL = r"accounted for: yes\nfiles: out/demo"
REPLAY = "demo PCAP=drive.pcap"
CERTIFICATES: tuple[str, ...] = ("authority.crt", "router.crt", "router.key")
CERTIFICATES += tuple(f"{r}.{k}" for r in ("monitor", "operator") for k in ("crt", "key"))
COMPOSE = "tests/system/test_compose.py and test_compose_up.py"
PACKAGES = "tests/system/test_packages.py, in a bare container"
CHANGES = "it would change this machine"
NETWORK_CARD = "changes or shows the network of the host, which has no sensor's card"

COMMANDS: dict[str, Kind] = {
    # Runs in README.md.
    "make demo": Runs(ALL_WELL, DEMO, slow=True),
    "make test": Excluded("this test is a part of it"),
    f"make {REPLAY}": Runs(ALL_WELL, DEMO, ("drive.pcap",)),
    f'make {REPLAY} SET="driver.model=VLP-16"': Runs(ALL_WELL, DEMO, ("drive.pcap",), slow=True),
    f"make {REPLAY} CONFIG=deploy/robots/ouster.yaml": Runs(ALL_WELL, DEMO, ("ouster",), slow=True),
    "make demo BAG=drive.mcap": Runs(ALL_WELL, DEMO, ("drive.mcap",), slow=True),
    "make demo BAG=clouds/": Runs(ALL_WELL, DEMO, ("clouds",), slow=True),
    "make demo KITTI=path/to/velodyne CONFIG=deploy/robots/hdl64e.yaml": Runs(
        ALL_WELL, DEMO, ("velodyne",), slow=True
    ),
    "make demo BIN=packets.bin": Runs(ALL_WELL, DEMO, ("packets.bin",), slow=True),
    "make demo SENSOR=hokuyo IMU=simulated": Runs(ALL_WELL, DEMO, slow=True),
    "make demo SESSION=drive.logr": Form("tests/integration/test_hokuyo.py, by zloam demo"),
    "bin/zloam recording drive.mcap": Runs(r"/points", needs=("drive.mcap",)),
    "bin/zloam evaluate TRAJECTORY TRUTH": Runs(
        r"ate_rmse_m: 0\.0\n",
        needs=("base.tum",),
        meaning=(("TRAJECTORY", "base.tum"), ("TRUTH", "base.tum")),
    ),
    "bin/zloam map convert out/demo/map.pcd map.laz --voxel 0.2": Form(
        "services/monitor/tests/test_maps.py"
    ),
    "bin/zloam map merge out/monday out/tuesday --out out/week": Form(
        "tests/integration/test_sessions.py"
    ),
    "zloam map merge out/monday --out out/closed": Form("tests/integration/test_merged_map.py"),
    "bin/zloam map grid out/demo/map.pcd grid.yaml": Form(
        "services/monitor/tests/test_map_exports.py"
    ),
    "bin/zloam trajectory out/demo/trajectory.tum drive.csv": Form(
        "services/monitor/tests/test_support.py"
    ),
    "bin/zloam compare out/demo out/other": Form("services/monitor/tests/test_support.py"),
    "bin/zloam web": Form("tests/integration/test_views.py"),
    "bin/zloam web --thin --connect 192.168.1.5": Form("tests/integration/test_preview.py"),
    "bin/zloam view": Form("tests/integration/test_views.py"),
    "bin/zloam foxglove": Form("tests/integration/test_views.py"),
    "bin/zloam record drive.mcap": Form("tests/integration/test_record.py"),
    "bin/zloam replay drive.mcap --from 30": Form("tests/integration/test_record.py"),
    "make view-tools": Form("make test, which installs the same"),
    "make demo VIEW=1": Runs(ALL_WELL, ("out/demo/run.mcap", *DEMO), slow=True),
    "make demo RECORD=drive.mcap": Runs(ALL_WELL, ("drive.mcap",), slow=True),
    "make run RECORD=drive.mcap": Form("tests/integration/test_readme.py, without a recording"),
    "zloam web": Form("tests/integration/test_views.py"),
    "zloam metrics": Form("services/monitor/tests/test_metrics.py"),
    "zloam metrics --connect ROBOT": Form("services/monitor/tests/test_metrics.py"),
    "zloam doctor": Form("tests/integration/test_doctor_live.py"),
    "zloam handover STAGE": Form("tests/integration/test_handover.py"),
    "bin/zloam doctor": Form("tests/integration/test_readme.py"),
    "bin/zloam doctor drive.pcap": Runs(r"all well", needs=("drive.pcap",)),
    "promtool test rules deploy/observability/alerts_test.yml": Excluded(
        "services/monitor/tests/test_metrics.py runs it where promtool is"
    ),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/observability.yml up -d": Form(COMPOSE),
    "docker compose run --rm --no-deps monitor watch --connect tcp/router:7447": Form(
        "tests/system/test_views_elsewhere.py"
    ),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/views.yml up -d --build": Form("tests/system/test_views_elsewhere.py"),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/views.yml logs view": Form("tests/system/test_views_elsewhere.py"),
    "zloam watch --connect ROBOT:7447": Form("tests/system/test_views_elsewhere.py"),
    "bin/zloam support out/demo": Form("services/monitor/tests/test_support.py"),
    "make run CONFIG=deploy/robots/vlp16-outdoor.yaml": LiveRun(
        r"no packets on UDP 2368 for \d+ s: ", LIVE
    ),
    "make run STANDBY=1": LiveRun(r"no packets on UDP 2368 for \d+ s: ", LIVE, slow=True),
    "zloam run --standby": Form("tests/integration/test_standby.py"),
    "make run LISTEN=0.0.0.0": LiveRun(r"open to the network: ", LIVE, slow=True),
    "make build": Form("every test that needs the programs"),
    # Commands beside a running robot.
    "bin/zloam robots": BesideRun(r"robot .*tcp/127\.0\.0\.1:7464"),
    "bin/zloam status": BesideRun(r"connected to robot 'robot' at tcp/127\.0\.0\.1:746"),
    "bin/zloam set odometry odometry.kernel_m=0.2": BesideRun(r"from sweep \d+"),
    "bin/zloam save maps/today": BesideRun(
        r"maps/today", ("out/demo/maps/today/map.pcd", "out/demo/maps/today/trajectory.tum")
    ),
    "bin/zloam map save town.laz": BesideRun(r"town\.laz: \d+ points", ("town.laz",)),
    "bin/zloam reset": BesideRun(r"map emptied"),
    "bin/zloam handover odometry": Form("tests/integration/test_handover.py"),
    "zloam handover mapping": Form("tests/integration/test_handover.py"),
    "bin/zloam place --x 12 --y -3.5 --yaw 90": Form("tests/integration/test_readme.py"),
    "zloam status --connect ROBOT": BesideRun(
        r"connected to robot 'robot' at tcp/127\.0\.0\.1:746", meaning=(("ROBOT", "127.0.0.1"),)
    ),
    "PYTHONPATH=build/release/generated/python .venv/bin/python "
    "services/monitor/examples/subscribe.py": BesideRun(r"(\d+ \d+( -?\d+\.\d\S*){3}\n){3}"),
    "bin/zloam --help": Runs(r"demo(.|\n)*status"),
    "bin/zloam config check my.yaml": Runs(r"my\.yaml", needs=("my.yaml",)),
    "bin/zloam ros": Form("tests/integration/test_ros.py runs it beside a replay"),
    "bin/zloam ros-lidar /points": Form("tests/integration/test_ros_lidar.py runs it"),
    "bin/zloam set": Form("the same with its words, above"),
    # Packages.
    "make packages": Form(PACKAGES),
    "pip install zloam-*.whl": Excluded(f"{PACKAGES}: it would change this Python"),
    "zloam demo": Form(f"{PACKAGES}, and as make demo"),
    "apt install ./zenoh-loam_*.deb": Excluded(f"{PACKAGES}: it would change this machine"),
    "pytest tests/system/test_packages.py": Form("make system"),
    "make test-full": Form("a person, before a larger change lands"),
    "deploy/build/release.sh build/release out/packages": Form("tests/integration/test_release.py"),
    # Containers.
    "apt install docker.io docker-cli docker-compose docker-buildx": Excluded(CHANGES),
    "apt install docker.io mmdebstrap": Excluded(CHANGES),
    "deploy/docker/images.sh": Form("tests/system/conftest.py"),
    "docker compose up": Form(COMPOSE),
    "docker compose up -d": Form(COMPOSE),
    "docker compose up -d driver": Form(COMPOSE),
    "docker compose down": Form(COMPOSE),
    "subnet=$(docker network inspect zenoh-loam_default "
    "--format '{{(index .IPAM.Config 0).Subnet}}')": Form("nobody: Docker's own command"),
    'for to in "$subnet" 127.0.0.0/8; do '
    'sudo iptables -t raw -I PREROUTING -i eth0 -d "$to" -j DROP; done': Excluded(CHANGES),
    "docker volume rm zenoh-loam_shm": Form("nobody: Docker's own command"),
    "docker compose restart": Form("Compose: the processes begin again"),
    "docker compose stop": Form("tests/system/live.py"),
    "docker compose up --scale registration=3": Form("tests/system/test_replicas.py"),
    "ZLOAM_WORLD=tunnel ZLOAM_RATE=realtime docker compose up": Form(COMPOSE),
    "docker compose exec mapping zloam mapping --health": Form("the health check itself"),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/standby.yml up -d": Form("tests/system/test_standby.py"),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/replicas.yml up -d": Form("tests/integration/test_compose_files.py"),
    "ZLOAM_STANDBY=true docker compose up --scale mapping=2": Form("tests/system/test_standby.py"),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml up -d": Form(
        "tests/system/test_compose_up.py"
    ),
    "docker compose -f docker-compose.yml -f deploy/compose/live.yml "
    "-f deploy/compose/secured.yml up -d": Form(
        "tests/integration/test_compose_files.py, and of the router tests/system/test_secured.py"
    ),
    "docker compose logs router": Form("Compose: what the router printed"),
    "docker run --rm zenoh-loam driver --help": Form("tests/system/test_compose_up.py"),
    "docker kill": Form("tests/system/test_replicas.py, by kill -9"),
    "docker tag zenoh-loam:arm64 zenoh-loam": Form("nobody: a name more for an image"),
    "docker tag zenoh-loam zenoh-loam:before": Form("nobody: a name more for an image"),
    "docker tag zenoh-loam:before zenoh-loam": Form("nobody: a name more for an image"),
    "docker save zenoh-loam:arm64 zenoh-loam-router:arm64 | ssh robot docker load": Excluded(
        "needs a robot"
    ),
    "deploy/zenoh/certificates.sh out/tls robot 10.0.0.2": Runs(
        r"router\.crt", tuple(f"out/tls/{name}" for name in CERTIFICATES)
    ),
    "zloam watch --connect "
    '"tls/10.0.0.2:7448#root_ca_certificate_file=authority.crt;connect_certificate_file=monitor.crt;'
    'connect_private_key_file=monitor.key;enable_mtls=true"': Form(
        "services/monitor/tests/test_tls_door.py"
    ),
    "zloam-mapping --health": Form("the health checks"),
    "ulimit -l": Runs(r"^(\d+|unlimited)\n$"),
    # The sensor's network.
    "ip addr add 192.168.1.100/24 dev eth1; ip link set eth1 up": Excluded(NETWORK_CARD),
    "tcpdump -ni eth1 udp port 2368": Excluded(NETWORK_CARD),
    "nft list ruleset": Excluded(NETWORK_CARD),
    "sysctl net.ipv4.conf.eth1.rp_filter=0": Excluded(NETWORK_CARD),
    "sysctl -w net.core.rmem_max=8388608": Excluded(NETWORK_CARD),
    "zloam metadata HOST FILE": Form("tests/integration/test_ouster_live.py, from a stand-in"),
    # Kubernetes.
    "kubectl apply -k deploy/kubernetes/simulated": Form("tests/integration/test_kubernetes.py"),
    "kubectl -n zenoh-loam delete job driver": Form("tests/integration/test_kubernetes.py"),
    "kubectl -n zenoh-loam rollout restart deployment": Form("nobody: needs a cluster"),
    "kubectl -n zenoh-loam rollout status deployment": Form("nobody: needs a cluster"),
    "kubectl label node NODE zenoh-loam/sensor=robot": Form("nobody: needs a cluster"),
    "kubectl apply -k deploy/kubernetes/live": Form("tests/integration/test_kubernetes.py"),
    "kubectl -n zenoh-loam scale deployment registration --replicas=3": Form(
        "nobody: needs a cluster"
    ),
}


def listings(text: str) -> list[tuple[str, str]]:
    """(language, lines) of each fenced block."""
    return [(match[1], match[2]) for match in _LISTING.finditer(text)]


def commands_of_listing(lines: str) -> list[str]:
    """The commands of a listing, without comments; continuation lines are joined."""
    joined = lines.replace("\\\n", " ")
    bare = (_COMMENT.sub("", line).strip() for line in joined.splitlines())
    return [" ".join(line.split()) for line in bare if line]


def commands_of_sentences(text: str) -> list[str]:
    """Inline code that begins with a program and has further words, or that names a script."""
    spans = (" ".join(span.split()) for span in _INLINE.findall(_LISTING.sub("", text)))
    return [span for span in spans if _is_command(span)]


def _is_command(span: str) -> bool:
    words = span.split()
    while words and _ASSIGNMENT.match(words[0]):
        words.pop(0)
    if not words or "…" in span or span == "bin/zloam":  # `bin/zloam` alone is a name
        return False
    if _PROGRAM.match(" ".join(words)):
        return True
    script = ROOT / words[0]
    return "/" in words[0] and script.is_file() and os.access(script, os.X_OK)


def commands(text: str) -> list[str]:
    found = [c for language, lines in listings(text) if language == SHELL
             for c in commands_of_listing(lines)]  # fmt: skip
    return found + commands_of_sentences(text)


def words(command: str) -> list[str]:
    """The words of a command, without leading assignments."""
    split = shlex.split(command)
    while _ASSIGNMENT.match(split[0]):
        split.pop(0)
    return split
