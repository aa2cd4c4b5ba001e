"""Compares data rates and lateness with given rates and delays."""

from __future__ import annotations

import pytest

from zloam_monitor import compose, messages, records
from zloam_monitor.records import StatusRecord
from zloam_monitor.traffic import MOST_STATUSES, OVER_SECONDS, Lateness, Published, Taken


def a_status(stage: str, seconds: float, counts: dict[str, int]) -> StatusRecord:
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    published = dict.fromkeys(counts, 1)
    payload = compose.status(
        stage, round(1e9 * seconds), 1, 1, [], published, published_bytes=counts
    )
    return records.status(payload)


def test_rates_are_differences_over_the_robot_s_own_time() -> None:
    """A status that arrives late counts for its own time."""
    published = Published()
    for second in range(4):
        published.take(a_status("a", 100.0 + second, {"x": 2000 * second, "y": 10**6, "z": second}))
        published.take(a_status("b", 100.2 + second, {"w": 500_000 * second}))
    assert published.kb_s() == {
        "w": pytest.approx(500.0),
        "x": pytest.approx(2.0),
        "z": pytest.approx(0.001),
    }
    assert list(published.kb_s()) == ["w", "x", "z"]


def test_replicas_of_a_stage_are_added_up() -> None:
    published = Published()
    for stage in ("a", "b"):
        for second in range(3):
            published.take(a_status(stage, second, {"x": 1000 * second}))
    assert published.kb_s() == {"x": pytest.approx(2.0)}


def test_a_rate_is_that_of_now() -> None:
    published = Published()
    for second in range(20):
        published.take(a_status("a", second, {"x": 9000 * min(second, 10)}))
    assert published.kb_s() == {}
    published.take(a_status("a", 20.0, {"x": 9000 * 10 + 5000}))
    assert published.kb_s() == {"x": pytest.approx(5.0 / OVER_SECONDS)}


def test_rates_go_on_when_the_robot_s_clock_is_set_back() -> None:
    """The last status of one that has gone has a stamp of the time before."""
    published = Published()
    for second in range(3):
        published.take(a_status("gone", 3600.0 + second, {"y": 1000 * second}))
        published.take(a_status("a", 3600.0 + second, {"x": 1000 * second}))
    for second in range(3, 6):
        published.take(a_status("a", float(second), {"x": 1000 * second}))
    assert published.kb_s() == {"x": pytest.approx(1.0)}


def test_who_has_gone_publishes_nothing() -> None:
    published = Published()
    for second in range(3):
        published.take(a_status("a", second, {"x": 1000 * second}))
        published.take(a_status("b", second, {"y": 1000 * second}))
    for second in range(3, 12):
        published.take(a_status("b", second, {"y": 1000 * second}))
    assert list(published.kb_s()) == ["y"]


def test_two_looks_at_once_tell_no_rate() -> None:
    published = Published()
    published.take(a_status("a", 5.0, {"x": 0}))
    published.take(a_status("a", 5.1, {"x": 10**6}))
    assert published.kb_s() == {}


def test_what_comes_here_is_counted() -> None:
    taken = Taken()
    assert taken.kb_s(0.0) is None
    taken.take(1000, 10.0)
    assert taken.kb_s(10.1) is None
    for tenth in range(1, 101):
        taken.take(1000, 10.0 + 0.1 * tenth)
    assert taken.kb_s(20.0) == pytest.approx(10.0, rel=0.03)
    assert taken.total == 101_000
    assert taken.kb_s(30.0) == 0.0


def test_lateness_is_the_backlog_of_most_whatever_the_clocks() -> None:
    late, ahead_s = Lateness(), 5000.0
    names = ("a", "b", "c")
    for second in range(30):
        for stage in names:
            # Two of three stages are on a link that carries half of the published data.
            came_s = second + ahead_s + (0.5 * second if stage != "c" else 0.1)
            late.take(a_status(stage, second, {}), round(1e9 * came_s))
    living = {(stage, a_status(stage, 0.0, {}).instance) for stage in names}
    assert late.seconds(living) == pytest.approx(14.5)
    assert late.seconds(set()) == 0.0


def test_a_clock_that_is_set_back_is_no_delay() -> None:
    late = Lateness()
    for second in range(20):
        stamp_s = 3600.0 + second if second < 10 else second
        late.take(a_status("a", stamp_s, {}), round(1e9 * (second + 0.01 * second)))
    living = {("a", a_status("a", 0.0, {}).instance)}
    assert late.seconds(living) == pytest.approx(0.09)


def test_a_stranger_s_flood_of_statuses_is_bounded() -> None:
    """Of one instance, within the time over which rates are taken."""
    published = Published()
    for number in range(1000):
        published.take(a_status("a", 100.0 + 0.001 * number, {"x": 1000 * number}))
    assert sum(map(len, published._seen.values())) == MOST_STATUSES
