"""Files as laboratories have them: one recording of three markers, written in each format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

LABELS = ("tip", "mid", "base")
FRAMES, RATE = 5, 50.0
TIMES = np.arange(FRAMES) / RATE
# Whole eighths of a mm, which text and single precision hold exactly; "mid" is not seen in frame 2.
XYZ = np.round(np.random.default_rng(1).uniform(-80, 80, (FRAMES, 3, 3)) * 8) / 8
XYZ[2, 1] = np.nan


def cells(values: Any, decimal: str = ".") -> list[str]:
    """Numbers as text; nothing for what was not seen."""
    return ["" if np.isnan(v) else f"{v:.6f}".replace(".", decimal) for v in np.ravel(values)]


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def trc(folder: Path) -> Path:
    head = [
        "PathFileType\t4\t(X/Y/Z)\ttake.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"50.00\t50.00\t{FRAMES}\t3\tmm\t50.00\t1\t{FRAMES}",
        "Frame#\tTime\t" + "\t\t\t".join(LABELS) + "\t\t",
        "\t\t" + "\t".join(f"{a}{i}" for i in (1, 2, 3) for a in "XYZ"),
        "",
    ]
    rows = ["\t".join([str(i + 1), f"{t:.5f}", *cells(XYZ[i])]) for i, t in enumerate(TIMES)]
    return write(folder / "take.trc", head + rows)


def trc_commas(folder: Path) -> Path:
    """As a spreadsheet leaves it: commas instead of tabs, lines of equal length; the unit as a word."""
    rows = [line.split("\t") for line in trc(folder).read_text(encoding="utf-8").splitlines()]
    lines = [",".join(row + [""] * (11 - len(row))) for row in rows]
    lines[2] = lines[2].replace(",mm,", ",Millimeters,")
    return write(folder / "commas.trc", lines)


def motive(folder: Path) -> Path:
    """A rigid body that turns by a right angle about z, and markers, in metres."""
    of, name, what, axes = ["", "Type"], ["", "Name"], ["", ""], ["Frame", "Time (Seconds)"]
    body = ["X", "Y", "Z", "W", "X", "Y", "Z", ""]
    of += ["Rigid Body"] * 8 + ["Marker"] * 9
    name += ["Gripper"] * 8 + [label for label in LABELS for _ in range(3)]
    what += ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 9
    axes += body + ["X", "Y", "Z"] * 3
    about = (
        "Format Version,1.23,Take Name,take,Capture Frame Rate,50.000000,Length Units,Meters,Coordinate Space,Global"
    )
    ids = ["", "ID"] + ["1"] * 17
    rows = []
    for i, t in enumerate(TIMES):
        half = np.radians(90 * i / (FRAMES - 1)) / 2
        pose = [0, 0, np.sin(half), np.cos(half), 0.01 * i, 0.5, 0.25]
        rows.append(",".join([str(i), f"{t:.6f}", *(f"{v:.9f}" for v in pose), "0.0001", *cells(XYZ[i] * 1e-3, ".")]))
    return write(folder / "motive.csv", [about, "", *(",".join(r) for r in (of, name, ids, what, axes)), *rows])


def motive_old(folder: Path) -> Path:
    """Version 1.21 in cm: a header without words, a time code, each marker also where the solved body has it, one label twice."""
    of = ["Rigid Body Marker"] * 9 + ["Marker"] * 12
    name = [f"Gripper:{label}" for label in LABELS for _ in "xyz"]
    name += [*name, *["Gripper:tip"] * 3]
    head = [
        "Format Version,1.21,Take Name,take,Length Units,Centimeters", "", ",,," + ",".join(of), ",,," + ",".join(name),
        ",,," + ",".join(["1"] * 21), ",,," + ",".join(["Position"] * 21), "Frame,Time,TimeCode" + ",X,Y,Z" * 7,
    ]  # fmt: skip
    rows = []
    for i, t in enumerate(TIMES):
        solved = np.nan_to_num(XYZ[i]) / 10 + 0.3
        rows.append(
            ",".join([str(i), f"{t:.6f}", f"15:26:46:12.{i:02}", *cells(solved), *cells(XYZ[i] / 10), "7", "8", "9"])
        )
    return write(folder / "motive_old.csv", [*head, *rows])


def nexus(folder: Path) -> Path:
    head = [
        "Devices", "1000", ",,Plate - Force,,", "Frame,Sub Frame,Fx,Fy,Fz", ",,N,N,N", "1,0,1,2,3", "",
        "Trajectories", "50", ",," + ",,,".join(f"Body:{label}" for label in LABELS) + ",,",
        "Frame,Sub Frame" + ",X,Y,Z" * 3, ",," + ",".join(["mm"] * 9),
    ]  # fmt: skip
    rows = [",".join([str(i + 1), "0", *cells(XYZ[i])]) for i in range(FRAMES)]
    return write(folder / "nexus.csv", [*head, *rows, ""])


def nexus_sections(folder: Path) -> Path:
    """Separated by tabs, with lines of equal length and sections behind the one of the markers."""
    body = [f"Body:{label}" for label in LABELS]
    table = [["Trajectories"], ["50"], ["", "", *(n for b in body for n in (b, "", ""))]]
    table += [["Frame", "Sub Frame", *"XYZXYZXYZ"], ["", "", *["mm"] * 9]]
    table += [[str(i + 1), "0", *cells(XYZ[i])] for i in range(FRAMES)]
    table += [
        [""],
        ["Segments"],
        ["50"],
        ["", "", "Body:Root"],
        ["Frame", "Sub Frame", "RX", "RY", "RZ", "TX", "TY", "TZ"],
    ]
    table += [["", "", *["deg"] * 3, *["mm"] * 3], ["1", "0", "1", "2", "3", "4", "5", "6"]]
    return write(folder / "nexus_tabs.csv", ["\t".join(row + [""] * (11 - len(row))) for row in table])


def tracker(folder: Path) -> Path:
    """Objects of Vicon Tracker: one that turns by a right angle about z, and one that is lost in frame 2."""
    head = [
        "Objects", "50", ",,Global Angle (Quaternion) Gripper:Gripper,,,,,,,Global Angle (Quaternion) Base:Base,,,,,,,",
        "Frame,Sub Frame" + ",RX,RY,RZ,RW,TX,TY,TZ" * 2 + ",", ",," + ",,,,mm,mm,mm," * 2,
    ]  # fmt: skip
    rows = []
    for i in range(FRAMES):
        half = np.radians(22.5 * i) / 2
        pose = [0, 0, np.sin(half), np.cos(half), 10.0 * i, 500, 250]
        base = [""] * 7 if i == 2 else ["0", "0", "0", "1", "1", "2", "3"]
        rows.append(",".join([str(i + 1), "0", *(f"{v:.9f}" for v in pose), *base]))
    return write(folder / "tracker.csv", [*head, *rows])


def qualisys(folder: Path) -> Path:
    """With events, a column header, Frame and Time, and tabs at the ends; a marker that is not seen stands at zero."""
    head = [
        f"NO_OF_FRAMES\t{FRAMES}", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t3", "FREQUENCY\t50", "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--", "TIME_STAMP\t2026-01-01, 10:00:00\t22107.99179716",
        "EVENT\tManual event\t2\t0.02000", "EVENT\tManual event\t3\t0.04000", "DATA_INCLUDED\t3D",
        "MARKER_NAMES\t" + "\t".join(LABELS), "TRAJECTORY_TYPES\t" + "\t".join(["Measured"] * 3),
        "Frame\tTime\t" + "\t".join(f"{label} {a}" for label in LABELS for a in "XYZ") + "\t",
    ]  # fmt: skip
    rows = ["\t".join([str(i + 1), f"{t:.5f}", *cells(np.nan_to_num(XYZ[i])), ""]) for i, t in enumerate(TIMES)]
    return write(folder / "qualisys.tsv", head + rows)


def qualisys_6d(folder: Path) -> Path:
    """A rigid body that turns by a right angle about z; the matrix is written column by column."""
    elements = "\t".join(f"Rot[{i}]" for i in range(9))
    head = [
        f"NO_OF_FRAMES\t{FRAMES}", "NO_OF_CAMERAS\t4", "NO_OF_BODIES\t1", "FREQUENCY\t50", "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--", "TIME_STAMP\t2026-01-01, 10:00:00\t22107.99179716", "DATA_INCLUDED\t6D",
        "BODY_NAMES\tGripper", f"Frame\tTime\tGripper X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t{elements}\t",
    ]  # fmt: skip
    rows = []
    for i in range(FRAMES):
        c, s = np.cos(np.radians(22.5 * i)), np.sin(np.radians(22.5 * i))
        matrix = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        pose = "\t".join(f"{v:.9f}" for v in [10.0 * i, 500, 250, 0, 0, 0, 0.1, *matrix.T.ravel()])
        rows.append(f"{i + 1}\t{TIMES[i]:.5f}\t{pose}\t")
    return write(folder / "bodies.tsv", head + rows)


def deeplabcut(folder: Path) -> Path:
    head = [
        ",".join([word, *values])
        for word, values in (
            ("scorer", ["DLC"] * 9),
            ("bodyparts", [label for label in LABELS for _ in "xyz"]),
            ("coords", list("xyz") * 3),
        )
    ]
    return write(folder / "dlc.csv", head + [",".join([str(i), *cells(XYZ[i])]) for i in range(FRAMES)])


def deeplabcut_animals(folder: Path) -> Path:
    """Of several animals: a line more in the header, and a part that belongs to none."""
    words = ["left", "right", "single"]
    levels = (("scorer", ["DLC"] * 9), ("individuals", [w for w in words for _ in "xyz"]))
    levels += (("bodyparts", [p for p in ("paw", "paw", "wall") for _ in "xyz"]), ("coords", list("xyz") * 3))
    head = [",".join([word, *values]) for word, values in levels]
    return write(folder / "dlc4.csv", head + [",".join([str(i), *cells(XYZ[i])]) for i in range(FRAMES)])


def deeplabcut_hdf5(folder: Path) -> Path:
    import pandas as pd

    names = pd.MultiIndex.from_product([["DLC"], LABELS, list("xyz")], names=["scorer", "bodyparts", "coords"])
    table = pd.DataFrame(XYZ.reshape(FRAMES, 9), columns=names)
    table.to_hdf(folder / "dlc.h5", key="df_with_missing", format="table", mode="w")
    return folder / "dlc.h5"


def anipose(folder: Path) -> Path:
    """The error of "tip" is 9 in frame 3, and "base" is seen by one camera in frame 4."""
    columns = [f"{label}_{what}" for label in LABELS for what in ("x", "y", "z", "error", "ncams", "score")]
    frame = [f"M_{i}{j}" for i in range(3) for j in range(3)] + [f"center_{i}" for i in range(3)]
    lines = [",".join([*columns, *frame, "fnum"])]
    for i in range(FRAMES):
        row = []
        for j in range(3):
            row += [*cells(XYZ[i, j]), "9.0" if (i, j) == (3, 0) else "1.5", "1" if (i, j) == (4, 2) else "3", "0.9"]
        lines.append(",".join([*row, *map(str, np.eye(3).ravel()), "0.0", "0.0", "0.0", str(i)]))
    return write(folder / "anipose.csv", lines)


def c3d(folder: Path) -> Path:
    import ezc3d

    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["LABELS"]["value"], point["UNITS"]["value"] = [RATE], list(LABELS), ["mm"]
    points = np.ones((4, 3, FRAMES))
    points[:3] = XYZ.transpose(2, 1, 0)
    file["data"]["points"] = points
    file.write(str(folder / "take.c3d"))
    return folder / "take.c3d"


def arrays() -> dict[str, Any]:
    """What MAT and HDF5 files hold here: another order of dimensions, a wrench, a pose."""
    pose = np.zeros((FRAMES, 7))
    pose[:, 0], pose[:, 3] = 10.0 * np.arange(FRAMES), 1.0
    return {
        "xyz": XYZ.transpose(1, 2, 0),
        "t": TIMES,
        "wrench": np.arange(6.0 * FRAMES).reshape(FRAMES, 6),
        "pose": pose,
    }


def mat(folder: Path) -> Path:
    from scipy.io import savemat

    names = np.array(LABELS, dtype=object)
    savemat(folder / "take.mat", {"trial": {"data": arrays(), "names": names}, "note": "none"})
    return folder / "take.mat"


def mat73(folder: Path) -> Path:
    """As MATLAB writes it: dimensions the other way round, a block of 512 bytes in front, cells as references."""
    import h5py

    path = folder / "take73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("trial/data")
        for name, array in arrays().items():
            made = group.create_dataset(name, data=np.atleast_2d(array).T)
            made.attrs["MATLAB_class"] = np.bytes_("double")
        names = file.create_dataset("trial/names", (3, 1), dtype=h5py.ref_dtype)
        for i, label in enumerate(LABELS):
            text = file.create_dataset(f"#refs#/{i}", data=np.array([[ord(c)] for c in label], dtype=np.uint16))
            text.attrs["MATLAB_class"] = np.bytes_("char")
            names[i, 0] = text.ref
        names.attrs["MATLAB_class"] = np.bytes_("cell")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    content = path.read_bytes()
    path.write_bytes(head.ljust(512, b"\0") + content[512:])
    return path


def hdf5(folder: Path) -> Path:
    """The arrays, and the same recording as a table."""
    import h5py

    columns = [f"{label}_{a}" for label in LABELS for a in "xyz"]
    with h5py.File(folder / "take.h5", "w") as file:
        for name, array in arrays().items():
            file[f"trial/data/{name}"] = array
        file["trial/names"] = list(LABELS)
        table = np.zeros(FRAMES, dtype=[("t", float), *((c, float) for c in columns)])
        table["t"] = TIMES
        for i, column in enumerate(columns):
            table[column] = XYZ.reshape(FRAMES, 9)[:, i]
        file["table"] = table
    return folder / "take.h5"


def volume(folder: Path) -> Path:
    """Volume correlation: vectors of the planes of a grid, and a group for each loaded step; the poses of a stage beside it."""
    import h5py

    lengths = 5, 4, 3
    axes = [np.linspace(0.0, 10.0, n) for n in lengths]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    poses = ["action,step,time,grasp,x,y,z,qw,qx,qy,qz", "1,0,0,II,0,0,0,1,0,0,0"]
    with h5py.File(folder / "scan.h5", "w") as file:
        for name, values in zip("xyz", axes, strict=True):
            file[name] = values
        for step in (1, 2, 3):
            for axis, name in enumerate("uvw"):
                file[f"step_{step}/{name}"] = 0.01 * step * grid[..., axis]
            file[f"step_{step}/zncc"] = np.full(lengths, 0.9)
            poses.append(f"1,{step},{step},II,{0.1 * step},0,0,1,0,0,0")
    (folder / "grasps.csv").write_text("\n".join(poses) + "\n", encoding="utf-8")
    return folder / "scan.h5"


REST = np.array([[x, y, 0.0] for y in (0.0, 10.0) for x in (0.0, 5.0, 10.0)])
MOVED = np.arange(FRAMES)[:, None, None] * np.linspace(0.125, 1.0, 18).round(3).reshape(6, 3)


def multidic(folder: Path) -> Path:
    """A cell with the points of each frame."""
    from scipy.io import savemat

    cell = np.empty((1, FRAMES), dtype=object)
    for i in range(FRAMES):
        cell[0, i] = REST + MOVED[i]
    savemat(folder / "DIC3DPPresults.mat", {"DIC3DPPresults": {"Points3D": cell, "Faces": np.zeros((4, 3))}})
    return folder / "DIC3DPPresults.mat"


def duodic(folder: Path) -> Path:
    """As DuoDIC saves it: version 7.3, cells with points, with the rigid motion taken out, with displacements and centroids."""
    import h5py

    path = folder / "DuoDIC.mat"
    shown = {
        "Points3D": REST + MOVED,
        "Points3D_ARBM": 0 * MOVED + REST,
        "Disp/DispVec": MOVED,
        "FaceCentroids": MOVED[:, :4],
    }
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, arrays_of in shown.items():
            cell = file.create_dataset(f"DIC3DPPresults/{name}", (FRAMES, 1), dtype=h5py.ref_dtype)
            cell.attrs["MATLAB_class"] = np.bytes_("cell")
            for i, array in enumerate(arrays_of):
                made = file.create_dataset(f"#refs#/{name.replace('/', '')}{i}", data=array.T)
                made.attrs["MATLAB_class"] = np.bytes_("double")
                cell[i, 0] = made.ref
    content = path.read_bytes()
    path.write_bytes(
        (b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM").ljust(512, b"\0") + content[512:]
    )
    return path


def ncorr(folder: Path) -> Path:
    """Displacements on a grid of 2 x 3 points, mm, as a struct array over frames; zero outside the region of interest."""
    from scipy.io import savemat

    kind = [(f"plot_{a}_ref_formatted", object) for a in "uv"]
    shown = np.empty((1, FRAMES), dtype=kind)
    for i in range(FRAMES):
        for j, a in enumerate("uv"):
            inside = np.arange(6) != 3
            inside[4] = i != 2
            shown[0, i][f"plot_{a}_ref_formatted"] = (MOVED[i, :, j] * inside).reshape(2, 3)
    info = {"pixtounits": 0.5, "spacing": 9.0, "units": "mm"}
    savemat(folder / "ncorr.mat", {"data_dic_save": {"displacements": shown, "dispinfo": info}})
    return folder / "ncorr.mat"


def vic3d(folder: Path) -> str:
    """A file for each frame; points that were not correlated have a sigma of -1 and zeros: one in the first frame, one later."""
    for i in range(FRAMES):
        lines = ['"X [mm]","Y [mm]","Z [mm]","U [mm]","V [mm]","W [mm]","sigma [pixel]","x [pixel]","y [pixel]"']
        for k in range(6):
            lost = (i, k) in ((0, 4), (3, 5))
            place = cells(np.zeros(6)) if lost else [*cells(REST[k]), *cells(MOVED[i, k])]
            lines.append(",".join([*place, "-1" if lost else "0.01", f"{100 + 10 * k}", "40"]))
        write(folder / f"vic_{i + 8}.csv", lines)
    return "vic_*.csv"


def aramis(folder: Path) -> str:
    """With decimal commas; the points stand in another order in each frame."""
    for i in range(FRAMES):
        lines = [
            "# exported by ARAMIS",
            "id;x [mm];y [mm];z [mm];displacement_x [mm];displacement_y [mm];displacement_z [mm]",
        ]
        rows = [";".join([str(k + 11), *cells(REST[k], ","), *cells(MOVED[i, k], ",")]) for k in range(6)]
        write(folder / f"stage_{i + 8}.csv", lines + (rows[::-1] if i % 2 else rows))
    return "stage_*.csv"


def nodemap(folder: Path) -> str:
    """As ARAMIS exports it on Windows: the header behind more than a hundred lines, padded, lost points as nan."""
    for i in range(FRAMES):
        lines = [f"# signal_{k:<40}: {k}" for k in range(150)] + ["# operator : J\u00fcrgen", "#" * 100]
        lines.append(
            "#       ID;    x_undef [mm];    y_undef [mm];    z_undef [mm];    u [mm];    v [mm];    w [mm];   epsx [%]"
        )
        for k in range(6):
            values = ["nan"] * 7 if (i, k) == (3, 5) else [*cells(REST[k]), *cells(MOVED[i, k]), "0.1"]
            lines.append(";".join(f"{v:>16}" for v in [str(k + 1), *values]))
        (folder / f"map_{i}.txt").write_bytes("\r\n".join(lines).encode("cp1252"))
    return "map_*.txt"


def matchid(folder: Path) -> str:
    """Positions as they are in the frame, commas within names, another order in each frame."""
    head = ["Coordinates.Image X [Pixel]", "Coordinates.Image Y [Pixel]", *(f"coor.{a} [mm]" for a in "XYZ")]
    head += [
        f"disp.{name} [mm]" for name in ("Horizontal Displacement U", "Vertical Displacement V", "Out-Of-Plane: W")
    ]
    head += ["stats.Sigma [mm]", "defgradient.F[0,0] [-]", "defgradient.F[0,1] [-]"]
    for i in range(FRAMES):
        rows = []
        for k in range(6):
            if (i, k) != (3, 5):
                pixel = [str(100 + 10 * (k % 3)), str(40 + 10 * (k // 3))]
                rows.append(",".join([*pixel, *cells(REST[k] + MOVED[i, k]), *cells(MOVED[i, k]), "1E-003", "1", "0"]))
        write(folder / f"Image_{i:04}_0.tiff.csv", [",".join(head), *(rows[::-1] if i % 2 else rows)])
    return "Image_*_0.tiff.csv"


def ros(folder: Path, kind: str) -> Path:
    """Markers as a MarkerArray at 50 Hz, the gripper as tf at 100 Hz, forces at 100 Hz. `kind`: ros1, ros2 or mcap."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    if kind == "ros1":
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    path = folder / ("take.bag" if kind == "ros1" else f"take_{kind}")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer: Any = Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
    topics = {
        "/markers": "visualization_msgs/msg/MarkerArray",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/ft": "geometry_msgs/msg/WrenchStamped",
        "/talk": "std_msgs/msg/String",
    }
    with writer:
        connections = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in topics.items()}
        for topic, stamp, message in sorted(_messages(store, kind), key=lambda one: one[1]):
            raw = (store.serialize_ros1 if kind == "ros1" else store.serialize_cdr)(message, topics[topic])
            writer.write(connections[topic], stamp, raw)
    return path


def _messages(store: Any, kind: str) -> Any:
    """Topic, time and message, in m."""
    make: dict[str, Any] = {name.rpartition("/")[2]: cls for name, cls in store.types.items() if "/msg/" in name}
    # ROS 1 has messages of these names besides.
    make |= {name: store.types[f"builtin_interfaces/msg/{name}"] for name in ("Time", "Duration")}

    def header(stamp: int) -> Any:
        more = {"seq": 0} if kind == "ros1" else {}
        return make["Header"](stamp=make["Time"](sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="lab", **more)

    def marker(stamp: int, number: int, xyz: Any) -> Any:
        pose = make["Pose"](position=make["Point"](*xyz), orientation=make["Quaternion"](0.0, 0.0, 0.0, 1.0))
        more: dict[str, Any] = {"uv_coordinates": [], "mesh_file": None, "texture": None, "texture_resource": ""}
        known = {f.name for f in make["Marker"].__dataclass_fields__.values()}
        if "mesh_file" in known:
            more["mesh_file"] = make["MeshFile"](filename="", data=np.zeros(0, np.uint8))
            more["texture"] = make["CompressedImage"](header=header(stamp), format="", data=np.zeros(0, np.uint8))
        return make["Marker"](
            header=header(stamp), ns="body", id=number, type=2, action=0, pose=pose,
            scale=make["Vector3"](0.01, 0.01, 0.01), color=make["ColorRGBA"](1.0, 1.0, 1.0, 1.0),
            lifetime=make["Duration"](sec=0, nanosec=0), frame_locked=False, points=[], colors=[], text="",
            mesh_resource="", mesh_use_embedded_materials=False, **{k: v for k, v in more.items() if k in known},
        )  # fmt: skip

    start = 1_700_000_000 * 10**9
    for i in range(FRAMES):
        stamp = start + round(i / RATE * 1e9)
        seen = [marker(stamp, j, XYZ[i, j] * 1e-3) for j in range(3) if np.isfinite(XYZ[i, j]).all()]
        yield "/markers", stamp, make["MarkerArray"](markers=seen)
    for i in range(2 * FRAMES):
        stamp = start + round(i / (2 * RATE) * 1e9)
        turn = make["Quaternion"](0.0, 0.0, 0.0, 1.0)
        moved = make["Transform"](translation=make["Vector3"](0.005 * i, 0.5, 0.25), rotation=turn)
        transform = make["TransformStamped"](header=header(stamp), child_frame_id="gripper", transform=moved)
        yield "/tf", stamp, make["TFMessage"](transforms=[transform])
        wrench = make["Wrench"](force=make["Vector3"](1.0 * i, 2.0, 3.0), torque=make["Vector3"](0.1, 0.2, 0.3))
        yield "/ft", stamp, make["WrenchStamped"](header=header(stamp), wrench=wrench)
    yield "/talk", start, make["String"](data="nothing of interest")
