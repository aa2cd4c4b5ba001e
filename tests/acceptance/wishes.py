"""What users of such systems ask for most often, numbered as in the list with which the project
began, with the tests that prove it; or the reason why there is none yet."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Wish:
    """One wish of the list, shortened."""

    what: str
    #: "FILE::test", "Suite.Test" of a unit test, or "accept NAME" of an acceptance line
    tests: tuple[str, ...] = ()
    #: what is not tested, and why
    lacks: str = ""


LIVE, SYSTEM, MONITOR = "tests/integration", "tests/system", "services/monitor/tests"
GRAPH, LOCALIZE, SESSIONS = (f"{LIVE}/test_{name}.py" for name in ("graph", "localize", "sessions"))

WISHES: dict[int, Wish] = {
    1: Wish("no drift in z", ("accept flat-z-flat", "accept kiss-flat")),
    2: Wish(
        "times and rings of points read right, or refused",
        (
            "tests/recordings/test_bag_clouds.py::test_what_follows_from_the_data_is_settled",
            "tests/recordings/test_bag_clouds.py::test_what_does_not_is_refused_with_what_settles_it",
            "accept inputs-no-time",
        ),
    ),
    3: Wish("save the map while it runs", (f"{LIVE}/test_live_outputs.py::*save*",)),
    4: Wish(
        "localise in a saved map",
        (f"{LOCALIZE}::test_it_is_found_where_the_map_was_left_and_the_map_stays",),
    ),
    5: Wish(
        "drops counted, no slowing down",
        ("accept laps-cost", f"{LIVE}/test_live_outputs.py::test_accounts_add_up_under_overload"),
    ),
    6: Wish("other models of lidar", (f"{LIVE}/test_decoder_peer.py::*", "Decoder.C2Vlp32cDual")),
    7: Wish("empty clouds and NaN", ("accept inputs-nan", "accept inputs-empty-one")),
    8: Wish("memory does not grow", ("accept laps-memory", "Mapper.WindowLosesNothing")),
    9: Wish(
        "few parameters, explained",
        (
            f"{LIVE}/test_robot_files.py::test_a_user_can_hold_the_keys",
            f"{LIVE}/test_robot_files.py::test_a_robots_file_states_what_it_sets",
        ),
    ),
    10: Wish("corridors and tunnels", ("accept flags-tunnel", "accept kiss-tunnel")),
    11: Wish(
        "clocks, and the top of the hour",
        ("Assembler.TheTopOfTheHourIsNoStep", "Assembler.EightThousandSecondsGoOnOverTwoHours"),
    ),
    12: Wish("evaluation", (f"{MONITOR}/test_evaluation.py::test_errors_equal_those_of_evo_*",)),
    13: Wish(
        "frames of ROS",
        (
            f"{LIVE}/test_ros.py::test_frames_lead_from_the_map_to_the_robot",
            "Se3.UpsideDownMountingTurnsUpIntoDown",
        ),
    ),
    14: Wish("covariance", ("accept nees-position-city", "accept nees-rotation-indoor")),
    15: Wish("straight from a capture", (f"{LIVE}/test_end_to_end.py::*",)),
    16: Wish("large messages arrive", ("accept transport-shm", "accept slow-reader-tcp")),
    17: Wish(
        "router, discovery, containers",
        (
            f"{SYSTEM}/test_compose.py::test_all_are_healthy_within_a_minute",
            f"{LIVE}/test_start.py::*",
            f"{MONITOR}/test_discovery.py::test_nobody_there_is_one_helpful_line",
        ),
    ),
    18: Wish(
        "loop closure",
        (
            f"{GRAPH}::test_closed_loops_are_nearer_to_the_truth",
            f"{GRAPH}::test_walls_are_single_where_loops_are_closed",
        ),
    ),
    19: Wish("the same result each time", (f"{LIVE}/test_same_bytes.py::*", "accept replay-twice")),
    20: Wish(
        "other rates, a part of the view, lost packets",
        ("accept hard-hand-5hz", "tests/recordings/test_bag_clouds.py::test_a_part_of_the_view"),
    ),
    21: Wish("two returns", ("Decoder.DualReturnPolicies",)),
    22: Wish(
        "found again after a pause, or carried",
        (
            "Restored.ACarriedRobotIsFoundByWhatStandsInTheRoom",
            f"{LIVE}/test_restart.py::test_after_a_silence_of_the_sensor_the_map_is_found_again",
        ),
    ),
    23: Wish("no trails of what moves", ("accept kiss-moving",), "what moves stays in the map"),
    24: Wish("several lidars", lacks="keys have the sensor's name; one lidar is used"),
    25: Wish(
        "IMU, ROS 2",
        ("accept imu-city", f"{LIVE}/test_ros.py::*"),
        "GNSS is published, and not used",
    ),
    26: Wish("a pose at the IMU's rate", lacks="nothing publishes one yet"),
    27: Wish("a level map", lacks="the map begins as base_link stands"),
    28: Wish("a georeferenced map", lacks="LAS and LAZ have no EPSG yet"),
    29: Wish(
        "several sessions",
        (
            f"{SESSIONS}::test_two_maps_of_the_same_streets_are_joined",
            f"{LOCALIZE}::test_a_map_is_extended_from_where_the_robot_is_found",
        ),
    ),
    30: Wish("laps cost no memory", ("accept laps-memory",)),
    31: Wish(
        "a grid for Nav2",
        (f"{MONITOR}/test_map_exports.py::test_a_grid_is_what_map_server_reads",),
        "a file; no key publishes it",
    ),
    32: Wish(
        "no false loop",
        ("LoopGraph.EqualPlacesFarApartAreNoLoop", "Sessions.AStreetThatRepeatsItselfJoinsNothing"),
        "a loop that was taken is not undone by command",
    ),
    33: Wish("wheel odometry", lacks="not planned with an issue yet"),
    34: Wish("sweeps without rings", ("accept ringless-mid360-city", "accept ringless-hap-city")),
    35: Wish(
        "Ouster, Hesai",
        (f"{LIVE}/test_ouster_peer.py::*", f"{LIVE}/test_hesai_drive.py::*"),
        "RoboSense has no decoder",
    ),
    36: Wish("several lidars with stamps of their own", lacks="one lidar is used"),
    37: Wish(
        "what moves out of the map",
        (f"{SESSIONS}::test_what_is_exported_others_can_read",),
        "as a saved map is exported: about 85 % of what moved",
    ),
    38: Wish("nothing moves at rest", ("MotionCheck.*",), "ten minutes are not measured"),
    39: Wish("somebody stands before it", lacks="not measured"),
    40: Wish("ARM", (f"{SYSTEM}/test_arm64.py::test_the_image_is_for_arm64",), "not run there"),
    41: Wish(
        "what is wrong with my set-up",
        (
            f"{MONITOR}/test_doctor.py::*",
            f"{LIVE}/test_doctor_live.py::*",
            "accept doctor-live",
            "accept doctor-files",
        ),
    ),
    42: Wish("no GPL", (f"{LIVE}/test_aloam.py::test_only_they_are_linked_with_pcl_and_ceres",)),
    43: Wish("edit the map", (f"{MONITOR}/test_maps.py::*crop*",), "cutting out only"),
    44: Wish("floors", lacks="a map has no floors; one above the other is one place to it"),
    45: Wish(
        "a big map in a browser",
        (
            f"{LIVE}/test_views.py::test_the_page_in_a_browser",
            f"{LIVE}/test_preview.py::test_it_keeps_up_with_a_drive_and_a_new_map",
        ),
    ),
    46: Wish(
        "sweeps with poses",
        (f"{LIVE}/test_record.py::test_foxglove_is_shown_what_the_stages_said",),
        "in a recording; no export to files",
    ),
    47: Wish(
        "intensity kept", (f"{MONITOR}/test_maps.py::test_each_format_holds_the_same_points",)
    ),
    48: Wish("an old map brought up to date", lacks="no list of what changed is made"),
    49: Wish("a camera", lacks="not planned with an issue yet"),
    50: Wish(
        "a file for support, runs compared",
        (
            f"{MONITOR}/test_support.py::test_the_file_for_support_holds_no_geometry",
            f"{MONITOR}/test_support.py::test_how_far_they_are_apart",
        ),
    ),
    51: Wish("ROS 2 reads us, and is our sensor", (f"{LIVE}/test_ros_lidar.py::*",)),
}
