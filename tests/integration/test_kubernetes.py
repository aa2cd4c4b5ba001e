"""The Kubernetes variant, against the published schemas and against the Compose file that it
mirrors."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from zloam_monitor.robot_file import RobotNames
from zloam_monitor.stages import PORT_ORDER, STAGES

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "deploy" / "kubernetes"
OVERLAYS = ("simulated", "live")
#: version of Kubernetes whose published schemas the files are validated against
VERSION = "1.29"
WORKLOADS = ("Deployment", "Job")
Resource = dict[str, Any]


def _resources(overlay: str) -> list[Resource]:
    """The resources of the overlay and of its base, as written in the folder."""
    return _listed("base") + _listed(overlay)


def _listed(folder: str) -> list[Resource]:
    """All resources in the files that a kustomization lists."""
    listed = yaml.safe_load((FOLDER / folder / "kustomization.yaml").read_text())["resources"]
    files = [FOLDER / folder / name for name in listed if name.endswith(".yaml")]
    return [each for file in files for each in yaml.safe_load_all(file.read_text())]


def _container(resource: Resource) -> Resource:
    (container,) = resource["spec"]["template"]["spec"]["containers"]
    return dict(container)


def _environment(resource: Resource) -> dict[str, str]:
    return {e["name"]: e["value"] for e in _container(resource).get("env", [])}


def test_the_replay_is_the_job_that_the_texts_delete() -> None:
    """Only then can it be applied again: Kubernetes refuses a change of a Job's pods."""
    (job,) = [r for r in _resources("simulated") if r["kind"] == "Job"]
    command = f"kubectl -n zenoh-loam delete job {job['metadata']['name']}\n"
    assert command in (ROOT / "deploy/README.md").read_text()
    assert "ttlSecondsAfterFinished" not in job["spec"]


def _waits_s(probe: Resource) -> int:
    """How long a probe fails without a break before Kubernetes acts."""
    return int(probe["periodSeconds"] * probe["failureThreshold"])


@pytest.mark.parametrize("folder", ["base", "live", "simulated", "preview"])
def test_only_a_process_that_answers_nothing_is_killed(folder: str) -> None:
    """Not one that is degraded, stands by or waits for its input: it answers, and is at work or
    will be."""
    workloads = [r for r in _listed(folder) if r["kind"] in WORKLOADS]
    assert workloads
    for each in workloads:
        name, container = each["metadata"]["name"], _container(each)
        router = name == "router"
        alive = ["zloam-router", "--health"] if router else ["zloam", name, "--alive"]
        for kind, at_least_s in (("startupProbe", 600), ("livenessProbe", 180)):
            probe = container[kind]
            assert probe["exec"]["command"] == alive, name
            assert _waits_s(probe) >= at_least_s, name
            assert probe["timeoutSeconds"] > container["readinessProbe"]["timeoutSeconds"], name
        ready = container["readinessProbe"]["exec"]["command"]
        assert ready == (alive if router else ["zloam", name, "--health"]), name


@pytest.mark.parametrize(("code", "alive"), [(0, True), (1, False), (2, True), (3, True)])
def test_a_file_that_is_refused_kills_no_stage(code: int, alive: bool, tmp_path: Path) -> None:
    """A mounted file changes below a stage that runs well with what it read at its start."""
    for name in ("zloam-driver", "zloam-mapping"):
        (tmp_path / name).write_text(f"#!/bin/sh\nexit {code}\n")
        (tmp_path / name).chmod(0o755)
    done = subprocess.run(
        [ROOT / "deploy/docker/zloam", "mapping", "--alive"],
        env={"PATH": f"{tmp_path}:{os.environ['PATH']}", "ZLOAM_CONFIG": "/robot/robot.yaml"},
        check=False,
    )
    assert (done.returncode == 0) == alive


class _Compose(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """Loads Compose's own tags (!override) without their meaning (how layers merge), which does not
    matter here."""


def _untagged(loader: _Compose, _suffix: str, node: yaml.Node) -> object:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node)
    assert isinstance(node, yaml.SequenceNode)
    return loader.construct_sequence(node)


_Compose.add_multi_constructor("!", _untagged)


def _compose(layer: str | None = None) -> dict[str, Any]:
    path = ROOT / (f"deploy/compose/{layer}.yml" if layer else "docker-compose.yml")
    services: dict[str, Any] = yaml.load(path.read_text(), _Compose)["services"]
    return services


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_every_resource_fits_the_published_schema(overlay: str) -> None:
    resources = _resources(overlay)
    assert len(resources) > 12
    for resource in resources:
        kubernetes_validate.validate(resource, VERSION, strict=True)


def test_a_misspelt_field_is_refused() -> None:
    resource = next(r for r in _resources("live") if r["kind"] == "Deployment")
    resource["spec"]["template"]["spec"]["hostNetwrok"] = True
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(resource, VERSION, strict=True)


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_rendered_by_kubectl_it_still_fits(overlay: str) -> None:
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed: patches and name references are not rendered")
    done = subprocess.run(
        ["kubectl", "kustomize", FOLDER / overlay], capture_output=True, text=True, check=True
    )
    rendered = list(yaml.safe_load_all(done.stdout))
    maps = {r["metadata"]["name"] for r in rendered if r["kind"] == "ConfigMap"}
    for resource in rendered:
        kubernetes_validate.validate(resource, VERSION, strict=True)
        if resource["kind"] in WORKLOADS:
            assert _container(resource)["image"].endswith(":latest")
            for source in _container(resource).get("envFrom", []):
                assert source["configMapRef"]["name"] in maps
    space = next(r for r in rendered if r["kind"] == "Namespace")
    level = space["metadata"]["labels"]["pod-security.kubernetes.io/enforce"]
    assert level == ("privileged" if overlay == "live" else "restricted")


def _rendered(folder: Path, overlay: str, *components: str) -> list[Resource]:
    """Rendered from a copy, with an overlay on top as a user writes it, and images of a registry of
    one's own as kubernetes/images is meant to be edited."""
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed")
    copy = folder / "kubernetes"
    shutil.copytree(FOLDER, copy)
    images = copy / "images/kustomization.yaml"
    own = "newName: reg.example/loam\n    newTag: v9"
    images.write_text(images.read_text().replace("newTag: latest", own, 1))
    (copy / "mine").mkdir()
    mine = {"resources": [f"../{overlay}"], "components": [f"../{c}" for c in components]}
    (copy / "mine/kustomization.yaml").write_text(yaml.safe_dump(mine))
    done = subprocess.run(
        ["kubectl", "kustomize", copy / "mine"], capture_output=True, text=True, check=True
    )
    rendered = list(yaml.safe_load_all(done.stdout))
    for resource in rendered:
        kubernetes_validate.validate(resource, VERSION, strict=True)
    return rendered


def _documented_order(component: str) -> list[str]:
    text = (FOLDER / component / "kustomization.yaml").read_text()
    (listed,) = re.findall(r"components: \[([^]]+)\]", text.partition("\nkind:")[0])
    return [each.strip().removeprefix("../") for each in listed.split(",")]


@pytest.mark.parametrize("component", ["preview", "standby"])
def test_images_of_another_registry_reach_every_pod(component: str, tmp_path: Path) -> None:
    rendered = _rendered(tmp_path, "live", *_documented_order(component))
    maps = {r["metadata"]["name"] for r in rendered if r["kind"] == "ConfigMap"}
    workloads = [r for r in rendered if r["kind"] in WORKLOADS]
    assert len(workloads) >= len(STAGES) + 2
    for each in workloads:
        name = each["metadata"]["name"]
        wanted = "zenoh-loam-router:latest" if name == "router" else "reg.example/loam:v9"
        assert _container(each)["image"] == wanted, name
        assert each["metadata"]["namespace"] == "zenoh-loam", name
        for source in _container(each).get("envFrom", []):
            assert source["configMapRef"]["name"] in maps, name


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_a_robot_file_of_ones_own_is_in_every_stage(overlay: str, tmp_path: Path) -> None:
    rendered = _rendered(tmp_path, overlay, "preview", "robot-file")
    (shared,) = (r["data"] for r in rendered if r["kind"] == "ConfigMap")
    stages = [r for r in rendered if r["kind"] in WORKLOADS and r["metadata"]["name"] != "router"]
    assert {r["metadata"]["name"] for r in stages} == {*STAGES, "store", "preview"}
    for each in stages:
        mounts = {m["name"]: m["mountPath"] for m in _container(each)["volumeMounts"]}
        volumes = {v["name"]: v for v in each["spec"]["template"]["spec"]["volumes"]}
        assert volumes["robot-file"]["configMap"] == {"name": "robot-file"}
        assert shared["ZLOAM_CONFIG"] == f"{mounts['robot-file']}/robot.yaml"


def _shared() -> dict[str, str]:
    """The environment common to all stages: the ConfigMap that the base generates."""
    listed = yaml.safe_load((FOLDER / "base/kustomization.yaml").read_text())
    (generator,) = listed["configMapGenerator"]
    return dict(literal.split("=", 1) for literal in generator["literals"])


def test_stages_are_found_as_in_compose() -> None:
    compose = {n: s.get("environment", {}) for n, s in _compose().items()}
    stages = {n for n, e in compose.items() if "ZLOAM_HOST" in e}
    workloads = {r["metadata"]["name"] for r in _resources("simulated") if r["kind"] in WORKLOADS}
    assert workloads - {"router"} == stages
    assert stages == {*STAGES, "store"}
    shared = _shared()
    for name in stages:
        for variable in ("ZLOAM_HOST", "ZLOAM_CONNECT", "ZLOAM_LISTEN"):
            assert shared.get(variable) == compose[name].get(variable), f"{name}: {variable}"


def test_the_same_stages_stand_by_as_in_compose() -> None:
    component = yaml.safe_load((FOLDER / "standby/kustomization.yaml").read_text())
    pairs = {each["name"]: each["count"] for each in component["replicas"]}
    compose = _compose("standby")
    assert pairs == {n: service["deploy"]["replicas"] for n, service in compose.items()}
    assert set(pairs) <= {r["metadata"]["name"] for r in _resources("live")}
    (generator,) = component["configMapGenerator"]
    told = dict(literal.split("=", 1) for literal in generator["literals"])
    assert generator["name"] == "robot"
    assert all(service["environment"] == told for service in compose.values())


def test_the_preview_is_as_in_compose() -> None:
    service, workload = _listed("preview")
    for resource in (service, workload):
        kubernetes_validate.validate(resource, VERSION, strict=True)
    (ports,) = service["spec"]["ports"]
    assert ports["port"] == RobotNames().base_port + PORT_ORDER.index("preview")
    compose = _compose("preview")["preview"]
    container = _container(workload)
    assert container["args"] == compose["command"]
    assert container["readinessProbe"]["exec"]["command"] == compose["healthcheck"]["test"][1:]
    for variable in ("ZLOAM_HOST", "ZLOAM_CONNECT"):
        assert compose["environment"][variable] == _shared()[variable]


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_every_peer_is_a_service_of_its_port(overlay: str) -> None:
    """Each endpoint in the configuration names a service of the base and a port of that service."""
    ports = {
        r["metadata"]["name"]: [p["port"] for p in r["spec"]["ports"]]
        for r in _resources(overlay)
        if r["kind"] == "Service"
    }
    shared = _shared()
    assert shared["ZLOAM_HOST"] == "<stage>"
    for stage in STAGES:
        assert RobotNames().base_port + PORT_ORDER.index(stage) in ports[stage]
    for endpoint in shared["ZLOAM_CONNECT"].split(","):
        protocol, address = endpoint.split("/")
        host, port = address.split(":")
        assert protocol == "tcp"
        assert int(port) in ports[host]


def test_the_live_driver_reads_the_sensor_as_in_compose() -> None:
    driver = next(
        r
        for r in _resources("live")
        if r["kind"] == "Deployment" and r["metadata"]["name"] == "driver"
    )
    # The robot's file says what the sensor is: a Hokuyo's has driver.source: scip.
    for setting in (
        _environment(driver)["ZLOAM_SET"],
        _compose("live")["driver"]["environment"]["ZLOAM_SET"],
    ):
        assert "driver." not in setting
    assert driver["spec"]["template"]["spec"]["hostNetwork"] is True


def _told(environment: dict[str, str], tmp_path: Path) -> dict[str, list[str]]:
    """The endpoints that a container's command gives its stage."""
    (tmp_path / "zloam-driver").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (tmp_path / "zloam-driver").chmod(0o755)
    done = subprocess.run(
        [ROOT / "deploy/docker/zloam", "driver", "--health"],
        env={"PATH": f"{tmp_path}:{os.environ['PATH']}", **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    settings = dict(re.findall(r"^zenoh\.(\w+)=(.*)$", done.stdout, re.MULTILINE))
    return {key: value.strip("[]").split(",") for key, value in settings.items()}


def test_the_live_driver_opens_no_port_of_its_node(tmp_path: Path) -> None:
    """Whoever reaches one, from any machine around, may read the run and publish into it."""
    (driver,) = [r for r in _listed("live") if r["kind"] == "Deployment"]
    told = _told(_shared() | _environment(driver), tmp_path)
    base = RobotNames().base_port
    assert told["listen"] == [f"tcp/127.0.0.1:{base}"]
    # With a base port, a stage that is told where to listen is taken for a second instance.
    assert told["base_port"] == ["0"]
    after = [f"tcp/{stage}:{base + PORT_ORDER.index(stage)}" for stage in STAGES[1:]]
    assert told["connect"] == [*after, _shared()["ZLOAM_CONNECT"]]
    others = [r for r in _listed("base") if r["kind"] == "Deployment"]
    assert not any(r["spec"]["template"]["spec"].get("hostNetwork") for r in others)
