"""Seeds for the fuzzers: one small well-formed input of each kind, made by rule."""

from __future__ import annotations

import struct
import sys
from pathlib import Path


def data_packet(toh_us: int, first_cdeg: int, mode: int) -> bytes:
    """A VLP-16 packet that sees 10 m everywhere."""
    blocks = b""
    for k in range(12):
        step = k // 2 if mode == 0x39 else k
        azimuth = (first_cdeg + 40 * step) % 36000
        blocks += struct.pack("<HH", 0xEEFF, azimuth) + struct.pack("<HB", 5000, 50) * 32
    return blocks + struct.pack("<IBB", toh_us, mode, 0x22)


def frame(payload: bytes) -> bytes:
    """Ethernet, IPv4, UDP."""
    udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
    ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0) + bytes(8)
    return bytes(12) + b"\x08\x00" + ip + udp


def block(kind: int, body: bytes) -> bytes:
    """One block of a pcapng file."""
    body += bytes(-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def pcapng(wire: bytes) -> bytes:
    """Two interfaces, a packet of each."""
    section = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    nanoseconds = struct.pack("<HHBxxxHH", 9, 1, 9, 0, 0)
    interfaces = block(1, struct.pack("<HHI", 1, 0, 65535) + nanoseconds)
    interfaces += block(1, struct.pack("<HHI", 113, 0, 2048))
    packets = b"".join(
        block(6, struct.pack("<IIIII", i, 1, 2, len(wire), len(wire)) + wire) for i in range(2)
    )
    return section + interfaces + packets


def write(folder: Path, name: str, content: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)


def main(target: Path) -> None:
    sentence = b"$GPRMC,213504,A,3708.0000,N,12139.0000,W,000.0,080.5,100918,013.3,E,D*04\r\n"
    for mode in (0x37, 0x39):
        packets = [data_packet(1_000_000 + 1327 * i, 35900 + 480 * i, mode) for i in range(3)]
        stream = b"".join(struct.pack("<H", len(p) + 1) + p + b"\0" for p in packets)
        write(target / "packets", f"mode{mode:x}", b"\x09" + stream)
    # An even length: header and tail are put in by the target.
    blocks = b"".join(
        struct.pack("<H", 18 * i) + struct.pack("<HBx", 2500, 9) * 32 for i in range(8)
    )
    hesai = bytes(12) + blocks + bytes(28)
    write(target / "packets", "hesai", b"\x0d" + 3 * (struct.pack("<H", len(hesai)) + hesai))
    write(target / "position", "rmc", (bytes(206) + sentence).ljust(512, b"\0"))
    write(target / "nmea", "rmc", sentence[1:-5])
    imu = b"\0\1\0\0" + struct.pack("<iII", 1_700_000_000, 0, 4) + b"imu\0"
    write(target / "ros", "imu", imu + struct.pack("<37d", *(0.125 * n for n in range(37))))
    # Checksums are put in by the target.
    device = b"MODL:U;,DMIN:23;,DMAX:60000;,ARES:1440;,AMIN:0;,AMAX:1080;,AFRT:540;,SCAN:2400;"
    lines = b"\n".join(device.split(b","))
    scan = b"MD0538054201000\n99\n_65>\n0?X00G001ooo7D`\n\n"
    echoes = b"NE0538053901000\n99\noooo\n0O@01T&1m002F0010000nP\n\n"
    asked = b"QT\n00\n\nTM2\n03\n\nVV\n00\n\nPP\n00\n" + lines + b"\n\nII\n00\nSTAT:well;\n\n"
    write(target / "scip", "session", b"\x01" + asked + scan + echoes)
    write(target / "scip", "dialogue", b"\x03" + asked + b"TM0\n00\n\nTM1\n00\n_65>\n\n" + scan)
    wire = frame(data_packet(1, 0, 0x37))
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    record = struct.pack("<IIII", 1, 2, len(wire), len(wire)) + wire
    write(target / "pcap", "two", head + record * 2)
    write(target / "pcap", "frame", wire)
    write(target / "pcap", "ng", pcapng(wire))
    names = b"t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"
    write(
        target / "tables", "imu", names + b"5000000,0,0.1,-1e-3,0,0,9.8\n10000000,0,0,0,0,0,9.8\n"
    )
    write(target / "tables", "semicolons", names.replace(b",", b";") + b"5;0,5;0;0;0;0;9,8\n")
    write(target / "tables", "times", b"# begin\n5.0\n5.1\n5.2\n")
    write(target / "tables", "spans", b"5.0 5.1\n5.1 5.2\n")
    text = b"s: {number: 2, deep: {count: 3}, flag: true, place: [0, 0, 1], list: [a, b]}\n"
    write(target / "settings", "yaml", text)
    write(target / "settings", "json", b'{"s.number": 2.5, "s.place": [0, 0, 1], "s.flag": true}')
    write(target / "settings", "live", b"s.number=3")
    # every choice of a message's maker is the usual one
    for stage in range(6):
        write(target / "messages", f"stage{stage}", bytes([stage]) + bytes(3000))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
