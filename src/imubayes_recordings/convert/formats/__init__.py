"""The formats of recordings, one module each; the content of a file decides, never its name."""

from pathlib import Path

from imubayes.foundations.errors import closest_first, input_error
from imubayes_recordings.convert.formats import (
    arrays,
    dataflash,
    gyroflow,
    matlab_and_hdf5,
    mdf,
    novatel,
    parquet,
    ros_bag,
    tdms,
    ulog,
    vectornav,
)
from imubayes_recordings.convert.formats.files_of_folder import FilesOfFolder
from imubayes_recordings.convert.formats.text import TextRecording
from imubayes_recordings.convert.formats.text_layout import is_padded_text
from imubayes_recordings.convert.recording import ForeignRecording, RecordingKind, SourceRecording

_HEAD = 4096
# Beginning of a file → what it is, and how it becomes one that is read.
_ELSEWHERE = (
    (
        b"H Product:Blackbox",
        "a Betaflight blackbox log",
        "blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2 LOG, and convert the CSV",
    ),
    (b"PK\x03\x04", "an archive or a spreadsheet", "unpack it, or save the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "a spreadsheet", "save the sheet as CSV"),
)

_ROS_BAG = RecordingKind("ROS bag", lambda head: head.startswith(ros_bag.MAGICS), ros_bag.RosBag, "rosbags")
KINDS = (
    RecordingKind("Parquet", lambda head: head.startswith(parquet.MAGIC), parquet.ParquetRecording),
    RecordingKind("NumPy .npy", lambda head: head.startswith(arrays.MAGIC), arrays.read_npy),
    RecordingKind("NumPy .npz", lambda head: head.startswith(b"PK\x03\x04") and b".npy" in head, arrays.read_npz),
    RecordingKind(
        "HDF5", lambda head: matlab_and_hdf5.HDF_MAGIC in (head[:8], head[512:520]), matlab_and_hdf5.read_hdf5
    ),
    RecordingKind("PX4 ULog", lambda head: head.startswith(ulog.MAGIC), ulog.ULogRecording, "pyulog"),
    _ROS_BAG,
    RecordingKind(
        "ArduPilot DataFlash", lambda head: head.startswith(dataflash.MAGICS), dataflash.DataFlashLog, "pymavlink"
    ),
    RecordingKind("TDMS", lambda head: head.startswith(tdms.MAGIC), tdms.TdmsRecording, "npTDMS"),
    RecordingKind("MDF", lambda head: head.startswith(mdf.MAGIC), mdf.MdfRecording, "asammdf"),
    RecordingKind("NovAtel RAWIMU", novatel.is_rawimu, novatel.RawImuLog),
    RecordingKind("Gyroflow", lambda head: head.startswith(gyroflow.MAGIC), gyroflow.GyroflowLog),
    RecordingKind("VectorNav sentences", vectornav.is_vectornav, vectornav.VectorNavLog),
    RecordingKind("MATLAB", lambda head: head.startswith(matlab_and_hdf5.MATLAB_MAGIC), matlab_and_hdf5.read_matlab),
)
"""The kinds that the beginning of a file determines; any other file is a text table."""


def _text(delimiter: str | None) -> RecordingKind:
    return RecordingKind("text", lambda head: True, lambda file: TextRecording(file, delimiter))


def open_recording(file: Path, delimiter: str | None = None) -> SourceRecording:
    """Return the recording that a file holds.

    Parameters
    ----------
    delimiter : of a text table, if it is stated.

    Raises
    ------
    InputError
        if the file does not exist, or is of no known kind.
    """
    if not file.exists():
        near = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
        allowed = closest_first(file.name, near)
        raise input_error(f"there is no file '{file}'", str(file), allowed, "give the path of the recording")
    if file.is_dir():
        return _of_folder(file, delimiter)
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    for kind in KINDS:
        if kind.fits(head):
            return ForeignRecording(file, kind)
    for sign, kind, remedy in _ELSEWHERE:
        if head.startswith(sign):
            what = f"the file is {kind}, which is not decoded here"
            raise input_error(what, str(file), "a text table of it, or another format", remedy)
    encoded = head.startswith((b"\xff\xfe", b"\xfe\xff", b"\x1f\x8b", b"BZh", b"\xfd7zXZ"))
    if b"\0" in head and not encoded and not is_padded_text(head):
        kinds = ", ".join(kind.name for kind in KINDS)
        raise input_error(
            "the file is of no known kind", str(file), f"text tables, {kinds}", "export the recording as one of these"
        )
    return ForeignRecording(file, _text(delimiter))


def _of_folder(folder: Path, delimiter: str | None) -> SourceRecording:
    """Return the recording of a folder: a ROS 2 bag, the only file of an EuRoC folder, or a file for each sensor."""
    if (folder / ros_bag.FOLDER_FILE).is_file():
        return ForeignRecording(folder, _ROS_BAG)
    for inside in ("data.csv", "imu0/data.csv", "mav0/imu0/data.csv"):
        if (folder / inside).is_file():
            return ForeignRecording(folder / inside, _text(delimiter))
    return FilesOfFolder(folder, lambda file: open_recording(file, delimiter))
