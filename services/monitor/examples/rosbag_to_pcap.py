"""Writes the Velodyne packets of a ROS 1 or 2 bag (velodyne_msgs/VelodyneScan) as a capture, for
`zloam demo --pcap`. Needs rosbags (pip install rosbags): python rosbag_to_pcap.py BAG OUT.pcap"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SCAN = "velodyne_msgs/msg/VelodyneScan"
PACKET = "builtin_interfaces/Time stamp\nuint8[1206] data\n"
#: to the port that the sensor sends to; lengths are filled in
ETHERNET = bytes.fromhex("ffffffffffff 6076886c0001 0800")
PORT = 2368


def framed(payload: bytes) -> bytes:
    """A UDP datagram from 192.168.1.201, without check sums."""
    udp = struct.pack(">HHHH", PORT, PORT, 8 + len(payload), 0)
    addresses = bytes([192, 168, 1, 201, 255, 255, 255, 255])
    ip = struct.pack(">BBHHHBBH", 0x45, 0, 28 + len(payload), 0, 0, 64, 17, 0) + addresses
    return ETHERNET + ip + udp + payload


def typestore() -> Any:
    """With the messages of the ROS driver, which ROS 2 bags do not carry."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(PACKET, "velodyne_msgs/msg/VelodynePacket"))
    scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    store.register(get_types_from_msg(scan, SCAN))
    return store


def convert(bag: Path, capture: Path) -> int:
    """The number of packets."""
    with AnyReader([bag], default_typestore=typestore()) as reader:
        wanted = [c for c in reader.connections if c.msgtype == SCAN]
        if not wanted:
            topics = ", ".join(f"{c.topic} ({c.msgtype})" for c in reader.connections)
            raise SystemExit(f"{bag}: no packets of a Velodyne in it, but {topics}")
        count = 0
        with capture.open("wb") as out:
            out.write(struct.pack("<IHHIIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1))
            for connection, _, raw in reader.messages(wanted):
                scan: Any = reader.deserialize(raw, connection.msgtype)
                for packet in scan.packets:
                    frame = framed(bytes(packet.data))
                    nanosec = getattr(packet.stamp, "nanosec", 0)
                    out.write(
                        struct.pack("<IIII", packet.stamp.sec, nanosec, len(frame), len(frame))
                    )
                    out.write(frame)
                    count += 1
    return count


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    print(f"{convert(Path(sys.argv[1]), Path(sys.argv[2]))} packets in {sys.argv[2]}")
