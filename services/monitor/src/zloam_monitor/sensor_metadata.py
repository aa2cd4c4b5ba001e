"""Fetches a sensor's description of itself over its HTTP API, for the file of driver.metadata.

For Ouster: one document since firmware 2.4 (/api/v1/sensor/metadata); before, its parts (paths
below the same one) and the configuration. The driver determines the model by itself.
"""

from __future__ import annotations

import http.client
import json
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

from zloam_monitor.failures import Explained

PATH = "/api/v1/sensor/metadata"
PARTS = (
    *("sensor_info", "beam_intrinsics", "imu_intrinsics", "lidar_intrinsics"),
    "lidar_data_format",
)
CONFIGURATION = "/api/v1/sensor/cmd/get_config_param?args=active"
PATIENCE_S = 10.0
#: Larger than the description of any sensor.
MOST_BYTES = 1 << 20
#: Parts without which the driver cannot use a description.
NEEDED = ("beam_intrinsics", "lidar_data_format")
#: What a host may cause that is none, or does not speak HTTP.
FAILURES = (urllib.error.URLError, OSError, http.client.HTTPException, ValueError)


class SensorError(Explained):
    """The sensor does not answer, or not as expected; the text says how."""


def fetched(host: str, get: Callable[[str], bytes] | None = None) -> dict[str, Any]:
    """The sensor's description; `host`: name or address, with the port if it is not 80."""
    ask = get or _get
    base = host if "://" in host else f"http://{host}"
    try:
        found = _document(ask, base + PATH)
    except urllib.error.HTTPError as error:
        if error.code != 404:
            raise SensorError(f"{base + PATH}: {error}") from error
        found = _assembled(ask, base)
    except FAILURES as error:
        reason = getattr(error, "reason", None) or str(error).strip() or type(error).__name__
        raise SensorError(f"{base}: no answer ({reason}); is it the sensor's address?") from error
    lacking = [name for name in NEEDED if name not in found]
    if lacking:
        raise SensorError(f"{base + PATH}: says nothing of {' and '.join(lacking)}")
    info = found.get("sensor_info")
    status = info.get("status", "RUNNING") if isinstance(info, dict) else "RUNNING"
    if status not in ("RUNNING", "STANDBY"):
        raise SensorError(f"{base}: the sensor is {status}: ask again when it is RUNNING")
    return found


def _assembled(ask: Callable[[str], bytes], base: str) -> dict[str, Any]:
    try:
        parts = {name: _document(ask, f"{base}{PATH}/{name}") for name in PARTS}
        parts["config_params"] = _document(ask, base + CONFIGURATION)
    except FAILURES as error:
        raise SensorError(f"{base}{PATH}: {error}") from error
    return parts


def _document(ask: Callable[[str], bytes], url: str) -> dict[str, Any]:
    answer = ask(url)
    try:
        found = json.loads(answer)
    except (ValueError, RecursionError) as error:
        raise SensorError(f"{url}: is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise SensorError(f"{url}: is no JSON object")
    return found


def _get(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        data: bytes = answer.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise SensorError(f"{url}: more than 1 MiB, which no sensor's description is")
    return data
