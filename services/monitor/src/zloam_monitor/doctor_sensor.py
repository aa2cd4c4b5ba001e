"""What the doctor finds in a driver's counts of packets."""

from __future__ import annotations

from collections.abc import Iterator

from zloam_monitor.heard import Finding, Heard

#: Share of lost messages below which nothing is reported.
FEW = 0.001
#: If packets come from another model than configured or named in them, about every other one seems
#: to be missing.
MISNAMED = 0.4
#: Figure in the driver's status -> finding and advice.
PACKETS = {
    "packets_unknown_model": (
        "packets name a model that is not known",
        "set driver.model to the one on the label",
    ),
    "packets_model_mismatch": (
        "packets of another sensor come on the same port",
        "give each sensor a port or an address of its own (driver.port, driver.sensor_address)",
    ),
    "packets_unknown_mode": ("packets name an unknown return mode", "set driver.returns"),
    "packets_bad_time": (
        "packets have no time that can be",
        "see the sensor's own page: its clock is not set, or the packets are damaged",
    ),
    "packets_short": ("packets are cut off", "record with a longer snap length (tcpdump -s 0)"),
    "frames_cut": ("frames are cut off", "record with a longer snap length (tcpdump -s 0)"),
    "datagrams_not_whole": (
        "packets miss some of their IP fragments",
        "let fragments through the firewall, or record on the sensor's own network card",
    ),
    "packets_duplicate": (
        "packets come twice",
        "record on one network card; live, look for a second path to the sensor",
    ),
    "kernel_drops": (
        "the kernel dropped packets",
        "raise net.core.rmem_max and driver.receive_buffer_bytes",
    ),
    "clock_steps": ("the sensor's clock was set", "see its receiver, or its time server"),
    "host_clock_steps": (
        "the host's clock was set, or packets were held up for seconds",
        "no stamp moved; keep the host's clock by chrony, and look for a slow link",
    ),
}


def of_sensor(heard: Heard) -> Iterator[Finding]:
    for who, status in heard.after.items():
        if status.stage != "driver" or who not in heard.living:
            continue
        received, lost = heard.more(who, "packets_received"), heard.more(who, "packets_lost")
        # A driver with a socket has this figure from the first packet on; other sources lack it.
        counted = {"packets_received", "datagrams"} & status.figures.keys()
        if counted and received <= 0 and not status.end_of_run:
            yield Finding(
                f"no packets came to the driver within {heard.seconds:.0f} s",
                "see deploy/README.md, Network of the sensor: address, port, firewall, cable",
            )
            if (others := heard.more(who, "datagrams_to_closed_ports")) > 0:
                yield Finding(
                    f"{others:.0f} datagrams came to UDP ports on which no program listens",
                    "if they are the sensor's, driver.port is another: tcpdump -n udp shows it",
                )
        else:
            yield from of_losses(
                received,
                lost,
                f"{lost:.0f} of {received + lost:.0f} packets were lost on the way",
                "give the sensor a network card of its own, and raise net.core.rmem_max",
            )
        for name, (what, do) in PACKETS.items():
            if (count := heard.more(who, name)) > 0:
                yield Finding(f"{what} ({count:.0f} within {heard.seconds:.0f} s)", do)


def of_losses(received: float, lost: float, what: str, do: str) -> Iterator[Finding]:
    """Findings from packet counts. If too many seem lost, the model is wrong instead."""
    if lost > MISNAMED * (received + lost):
        yield Finding(
            f"{lost:.0f} packets seem to be missing beside {received:.0f}: they come at another "
            "pace than the model has that is configured, or that they name",
            "set driver.model to the model on the sensor's label",
        )
    elif lost > FEW * (received + lost):
        yield Finding(what, do)
