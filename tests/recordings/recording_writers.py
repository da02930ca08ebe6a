"""Writers of foreign recordings, byte by byte from the specifications; they share no code with the readers."""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np

NAMES = ("ax", "ay", "az", "gx", "gy", "gz")


def as_matrix(columns: dict[str, np.ndarray], names: tuple[str, ...] = ("time_s", *NAMES)) -> np.ndarray:
    return np.stack([columns[name] for name in names], axis=1)


def npy(values: np.ndarray) -> bytes:
    """NumPy format 1.0: magic, version, length of the header, header, data in C order."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {values.shape}, }}"
    header = header.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + values.astype("<f8").tobytes()


def matlab5(arrays: dict[str, np.ndarray]) -> bytes:
    """MATLAB 5.0 MAT-file: a header of 128 bytes, and one miMATRIX element for each array of doubles."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    content = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + struct.pack("<H", 0x0100) + b"IM"
    for name, values in arrays.items():
        values = values[:, None] if values.ndim == 1 else values
        parts = element(6, struct.pack("<II", 6, 0))  # array flags: class double
        parts += element(5, struct.pack("<ii", *values.shape))
        parts += element(1, name.encode())
        parts += element(9, values.astype("<f8").tobytes(order="F"))
        content += element(14, parts)
    return content


def ulog(messages: dict[str, tuple[list[tuple[str, str]], np.ndarray]]) -> bytes:
    """PX4 ULog: header, flag bits, one format and subscription for each message, and its rows.

    `messages` is name → fields (type and name, the first is uint64_t timestamp) and rows, one column for each element.
    """

    def message(kind: str, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    codes = {"uint64_t": "Q", "float": "f", "int16_t": "h", "float[3]": "3f"}
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    for name, (fields, _) in messages.items():
        content += message("F", f"{name}:{''.join(f'{kind} {field};' for kind, field in fields)}".encode())
    for number, name in enumerate(messages):
        content += message("A", struct.pack("<BH", 0, number) + name.encode())
    for number, (fields, rows) in enumerate(messages.values()):
        code = "<" + "".join(codes[kind] for kind, _ in fields)
        for row in rows:
            content += message("D", struct.pack("<H", number) + struct.pack(code, int(row[0]), *row[1:]))
    return content


def dataflash(rows: np.ndarray) -> bytes:
    """ArduPilot DataFlash: FMT messages, and IMU messages with microseconds, an instance, gyros and accelerometers."""

    def fmt(kind: int, length: int, name: str, codes: str, labels: str) -> bytes:
        head = struct.pack("<BBBBB", 0xA3, 0x95, 128, kind, length)
        return head + name.encode().ljust(4, b"\0") + codes.encode().ljust(16, b"\0") + labels.encode().ljust(64, b"\0")

    content = fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    content += fmt(200, 3 + 8 + 1 + 24, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for row in rows:
        force, rate = row[1:4], row[4:7]
        content += struct.pack("<BBBQB6f", 0xA3, 0x95, 200, round(1e6 * row[0]), 0, *rate, *force)
    return content


def tdms(group: str, columns: dict[str, np.ndarray], properties: dict[str, float]) -> bytes:
    """NI TDMS, one segment: lead-in, objects with their raw index and properties, data channel after channel."""

    def text(word: str) -> bytes:
        return struct.pack("<I", len(word.encode())) + word.encode()

    metadata = struct.pack("<I", 2 + len(columns))
    metadata += text("/") + struct.pack("<II", 0xFFFFFFFF, 0)
    metadata += text(f"/'{group}'") + struct.pack("<II", 0xFFFFFFFF, 0)
    for name, values in columns.items():
        metadata += text(f"/'{group}'/'{name}'") + struct.pack("<IIIQ", 20, 10, 1, len(values))
        metadata += struct.pack("<I", len(properties))
        for key, value in properties.items():
            metadata += text(key) + struct.pack("<Id", 10, value)
    raw = b"".join(values.astype("<f8").tobytes() for values in columns.values())
    return b"TDSm" + struct.pack("<IIQQ", 0xE, 4713, len(metadata) + len(raw), len(metadata)) + metadata + raw


def cdr_imu(seconds: float, force: np.ndarray, rate: np.ndarray) -> bytes:
    """A sensor_msgs/msg/Imu in CDR, little endian; doubles are aligned to 8 bytes behind the encapsulation."""
    nanoseconds = round(1e9 * seconds)
    body = struct.pack("<iII", nanoseconds // 10**9, nanoseconds % 10**9, 4) + b"imu\0"
    body += b"\0" * (-len(body) % 8) + struct.pack("<4d9d", 0, 0, 0, 1, *[0.0] * 9)
    return b"\0\1\0\0" + body + struct.pack("<3d9d3d9d", *rate, *[0.0] * 9, *force, *[0.0] * 9)


def ros2_db3(file: Path, rows: np.ndarray) -> None:
    """A ROS 2 bag of storage sqlite3, version 2 of its schema, with one topic of Imu messages."""
    with closing(sqlite3.connect(file)) as connection, connection as base:
        base.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
        base.execute("INSERT INTO schema VALUES (3, 'humble')")
        base.execute("CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER, metadata TEXT)")
        base.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL)"
        )
        base.execute("INSERT INTO topics VALUES (1, '/imu/data', 'sensor_msgs/msg/Imu', 'cdr', '')")
        base.executemany(
            "INSERT INTO messages VALUES (?, 1, ?, ?)",
            [(k + 1, round(1e9 * row[0]) + 10**6, cdr_imu(row[0], row[1:4], row[4:7])) for k, row in enumerate(rows)],
        )


def rawimu(columns: dict[str, np.ndarray], accel: float, gyro: float) -> str:
    """NovAtel RAWIMUSA lines: increments over one sample in counts, order z, −y, x."""
    lines = ["#BESTPOSA,COM1,0,50.0,FINESTEERING,1105,425384.000,02000040,0000,0;SOL_COMPUTED,SINGLE,51.1*7e93a1b2"]
    for time, ax, ay, az, gx, gy, gz in as_matrix(columns):
        counts = [round(v * accel) for v in (az, -ay, ax)] + [round(v * gyro) for v in (gz, -gy, gx)]
        seconds = f"{425384 + time:.9f}"
        lines.append(
            f"%RAWIMUSA,1105,{425384 + time:.3f};1105,{seconds},00000077,{','.join(map(str, counts))}*5aa97065"
        )
    return "\r\n".join(lines) + "\r\n"


def vectornav(rows: np.ndarray) -> str:
    """VNIMU sentences: magnetic field, force, rate, temperature and pressure, with the exclusive or of all bytes."""
    lines = []
    for row in rows:
        values = [0.2, -0.1, 0.45, *row[1:7], 24.5, 101.3]
        body = "VNIMU," + ",".join(f"{value:+.9f}" for value in values)
        check = 0
        for byte in body.encode():
            check ^= byte
        lines.append(f"${body}*{check:02X}")
    return "\r\n".join(lines) + "\r\n"


def gyroflow(rows: np.ndarray, factors: tuple[float, float, float]) -> str:
    """A Gyroflow log: keys, names, and times, rates and forces over their factors in s, rad/s and g."""
    time, rate, force = factors
    keys = [f"tscale,{time:.9g}", f"gscale,{rate:.9g}", f"ascale,{force:.9g}", "t,gx,gy,gz,ax,ay,az"]
    values = np.column_stack([rows[:, 0] / time, rows[:, 4:7] / rate, rows[:, 1:4] / 9.80665 / force])
    lines = [",".join(f"{value:.15g}" for value in row) for row in values]
    return "\n".join(["GYROFLOW IMU LOG", "version,1.3", "id,own", "orientation,XYZ", *keys, *lines]) + "\n"


def mdf4(columns: dict[str, tuple[str, np.ndarray]]) -> bytes:
    """Return a file of one group: name → unit and values; the first is the master, the others are stored halved."""
    out = bytearray(MDF_HEAD)

    def block(kind: bytes, links: tuple[int, ...], data: bytes) -> int:
        place = len(out)
        data += bytes(-len(data) % 8)
        out.extend(struct.pack(f"<4s4xQQ{len(links)}Q", kind, 24 + 8 * len(links) + len(data), len(links), *links))
        out.extend(data)
        return place

    def text(words: str) -> int:
        return block(b"##TX", (), words.encode() + b"\0")

    head = block(b"##HD", (0,) * 6, struct.pack("<QhhBBBxdd", 1_700_000_000 * 10**9, 0, 0, 0, 0, 0, 0.0, 0.0))
    rows = np.stack([values if k == 0 else values / 2 for k, (_, values) in enumerate(columns.values())], axis=1)
    doubled = struct.pack("<BBHHHdddd", 1, 0, 0, 0, 2, 0.0, 0.0, 0.0, 2.0)
    following = 0
    for place, (name, (unit, _)) in reversed([*enumerate(columns.items())]):
        conversion = block(b"##CC", (0,) * 4, doubled) if place else 0
        links = (following, 0, text(name), 0, conversion, 0, text(unit), 0)
        kind = (0, 0) if place else (2, 1)
        following = block(
            b"##CN", links, struct.pack("<BBBBIIIIBxH6d", *kind, 4, 0, 8 * place, 64, 0, 0, 0, 0, *[0.0] * 6)
        )
    group = block(
        b"##CG", (0, following, 0, 0, 0, 0), struct.pack("<QQHHIII", 0, len(rows), 0, 0, 0, 8 * len(columns), 0)
    )
    data = block(b"##DT", (), rows.astype("<f8").tobytes())
    groups = block(b"##DG", (0, group, data, 0), struct.pack("<B7x", 0))
    struct.pack_into("<Q", out, head + 24, groups)
    return bytes(out)


MDF_HEAD = struct.pack("<8s8s8s4xH30xHH", b"MDF     ", b"4.10    ", b"written ", 410, 0, 0)
