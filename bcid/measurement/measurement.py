"""The measurement: where the fiducials were while a gripper moved the body.

One `Measurement` holds any number of actions. A frame is one step of one action. Everything inside is SI; the units of
the files it came from are kept, so that it is written back in them. The folder format is described in
docs/measurement.md.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.fingerprint import fingerprint
from bcid.base.units import LEAST_SIGMA, measurable, with_units
from bcid.measurement.contents import FORMAT, SIGMAS, Cloud, Contents, Units
from bcid.measurement.folder import read_folder
from bcid.measurement.folder_writer import write_folder
from bcid.measurement.frame_error import FrameError
from bcid.measurement.mapped import read_mapped
from bcid.measurement.plausibility import examine
from bcid.measurement.stated import SCALE_KEYS, Stated

if TYPE_CHECKING:
    from bcid.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measurement(Contents):
    """Trajectories of fiducials, motions of the gripper, and what else was recorded; see `Contents` for what it holds."""

    @classmethod
    def read(cls, path: str | Path) -> Measurement:
        """Open a measurement folder, a NetCDF file written by `to_netcdf`, or a mapping file for a foreign recording.

        Raises:
            InputError: with every problem of the files.
        """
        path = Path(path)
        if path.suffix == ".nc":
            return cls.from_netcdf(path)
        if path.suffix == ".toml" and path.is_file():
            return cls(**vars(read_mapped(path))).validated()
        return cls(**vars(read_folder(path)))

    def write(self, folder: str | Path) -> None:
        """Write the folder format in this measurement's units; an existing folder is refused."""
        write_folder(self, Path(folder))

    def to_netcdf(self, path: str | Path) -> None:
        """Write everything into one NetCDF file (SI units, which every variable states)."""
        data = self.data.copy()
        data.attrs = {"format": FORMAT, "description": self.description}
        data.attrs |= {f"{name}_unit": getattr(self.units, name) for name in ("length", "time", "force")}
        for name in SIGMAS:
            if getattr(self, name) is not None:
                data.attrs[name] = getattr(self, name)
        if self.scale_sigma is not None:
            data.attrs["scale_sigma"] = self.scale_sigma
        if self.scale_of_gripper:
            data.attrs["scale_of_gripper"] = 1
        if self.frame_error is not None:
            data.attrs["frame_centre"] = self.frame_error.centre
            data.attrs["frame_covariance"] = self.frame_error.covariance.ravel()
        if self.cloud is not None:
            data = data.assign(self.cloud.variables(self.data))
        if not self.fiducial_names:
            # In this format a dimension without length is one without end.
            data = data.drop_dims("fiducial")
        with_units(data).to_netcdf(path, engine="scipy")

    @classmethod
    def from_netcdf(cls, path: str | Path) -> Measurement:
        """Read what `to_netcdf` wrote."""
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        try:
            with xr.open_dataset(path, engine="scipy") as opened:
                data = opened.load()
        except (OSError, ValueError, TypeError, IndexError, KeyError) as error:
            raise InputError(f"{path}: not a NetCDF measurement: {error}") from None
        attrs, data.attrs = dict(data.attrs), {}
        if attrs.get("format") != FORMAT:
            raise InputError(f"{path}: expected format '{FORMAT}', found {attrs.get('format')!r}")
        stated = ("length_unit", "time_unit", "force_unit")
        missing = [name for name in stated if name not in attrs]
        if missing:
            raise InputError(f"{path}: its attributes lack {', '.join(missing)}")
        for name in ("action", "grasp", "fiducial", "axis", "component", "place", "quaternion"):
            if name in data:
                data[name] = data[name].astype(str)
        units = Units(*(str(attrs[name]) for name in stated))
        # Refuses units that are none.
        _ = units.factors
        noise, force, torque = (float(attrs[name]) if name in attrs else None for name in SIGMAS)
        cloud, data = Cloud.taken(data)
        if cloud is not None and "fiducial" not in data.dims:
            data = data.assign_coords(fiducial=[])
            data["position"] = (("frame", "fiducial", "axis"), np.zeros((data.sizes["frame"], 0, 3)))
        of_frame = None
        if {"frame_centre", "frame_covariance"} & set(attrs):
            problems = Problems(f"measurement {path}")
            numbers = attrs.get("frame_centre"), attrs.get("frame_covariance")
            of_frame = FrameError.checked(*numbers, path, problems)
            problems.raise_if_any()
        about = units, str(attrs.get("description", "")), str(path), of_frame
        found = cls(data, noise, force, *about, torque_sigma=torque, cloud=cloud)
        of_gripper = bool(attrs.get("scale_of_gripper", False))
        return replace(found, scale_sigma=attrs.get("scale_sigma"), scale_of_gripper=of_gripper).validated()

    def validated(self) -> Measurement:
        """This measurement with its dimensions in order, or an `InputError` with everything that is wrong with it.

        What the folder's reader checks line by line is checked here for every other way in.
        """
        problems = Problems(f"measurement {self.source}")
        data = _in_order(self.data, problems, self.source)
        problems.raise_if_any()
        checked = replace(self, data=data)
        for name in SIGMAS:
            value = getattr(self, name)
            if value is not None and not measurable(value):
                problems.add(self.source, f"{name}: expected a positive number from {LEAST_SIGMA:g}, found {value!r}")
        checked = replace(checked, scale_sigma=Stated(Path(self.source), problems).scale(vars(self)))
        if checked.cloud is None and not np.isfinite(checked.positions).any():
            problems.add(self.source, "holds no position: no fiducial was ever seen")
        for action in checked.action_names:
            checked._check_action(action, problems)
        problems.raise_if_any()
        return checked

    def _check_action(self, name: str, problems: Problems) -> None:
        """Rising steps from 0, times that do not fall, one grasp, finite poses, the rest pose at step 0."""
        rows = self.data.isel(frame=np.flatnonzero(self.data["action"].values.astype(str) == name))
        translation, rotation = (np.asarray(rows[key].values, dtype=float) for key in ("translation", "rotation"))
        steps, times = rows["step"].values, rows["time"].values
        grasps, lengths = set(rows["grasp"].values.astype(str)), np.linalg.norm(rotation, axis=1)
        moved = np.abs(translation[0]).max() > 1e-6 or abs(rotation[0, 0]) < 1 - 1e-6
        wrong = {
            "its steps must rise from 0": steps[0] != 0 or (np.diff(steps) <= 0).any(),
            "its times must be finite and not go back": not np.isfinite(times).all() or (np.diff(times) < 0).any(),
            "it uses more than one grasp": len(grasps) > 1,
            "a pose of the gripper is not finite": not (np.isfinite(translation).all() and np.isfinite(rotation).all()),
            "a rotation is not a unit quaternion": (np.abs(lengths - 1) > 1e-3).any(),
            "at step 0 the gripper must be at rest: translation 0 0 0, rotation 1 0 0 0": moved,
        }
        for text in (text for text, found in wrong.items() if found):
            problems.add(self.source, f"action {name}: {text}")

    def fingerprint(self) -> str:
        """Short hash of the content; equal measurements have equal fingerprints whatever file they came from."""
        arrays = {name: self.data[name].values for name in sorted(map(str, self.data.variables))}
        if self.frame_error is not None:
            arrays |= {"frame_centre": self.frame_error.centre, "frame_covariance": self.frame_error.covariance}
        torque = {} if self.torque_sigma is None else {"torque": self.torque_sigma}
        scale = {key: getattr(self, key) for key in SCALE_KEYS if getattr(self, key)}
        if self.cloud is not None:
            arrays |= self.cloud.arrays()
        return fingerprint({"noise": self.noise_sigma, "wrench": self.wrench_sigma, **torque, **scale, **arrays})

    def without_forces(self) -> Measurement:
        """The same with the force of the gripper not measured."""
        return replace(self, data=self.data.drop_vars(["wrench", "component"], errors="ignore"))

    def without(self, names: Collection[str]) -> Measurement:
        """The same with nothing seen of some fiducials."""
        data = self.data.copy(deep=True)
        data["position"][{"fiducial": [self.fiducial_names.index(name) for name in names]}] = np.nan
        return replace(self, data=data)

    def check(self, scene: Scene) -> list[str]:
        """Refuse names that the scene does not have, and what cannot be a measurement of it; says what is odd.

        Raises:
            InputError: with every problem; see `bcid.measurement.plausibility`.
        """
        self.check_names(scene)
        problems = Problems(f"measurement {self.source} does not fit scene {scene.source}")
        _check_scale(scene, self, problems)
        markers = [name for name in self.fiducial_names if name not in set(scene.surface)]
        # Marks on a surface are where the points are: they cannot be misplaced, and follow no path of their own.
        odd = examine(scene, replace(self, data=self.data.sel(fiducial=markers)), problems) if markers else []
        problems.raise_if_any()
        return list(dict.fromkeys([*self.remarks, *odd]))

    def check_names(self, scene: Scene) -> None:
        """Refuse names that the scene does not have.

        Raises:
            InputError: with every one.
        """
        problems = Problems(f"measurement {self.source} does not fit scene {scene.source}")
        known = {"fiducial": list(scene.fiducials), "grasp": list(scene.grasps), "place": list(scene.places)}
        for what, names in known.items():
            used = [str(n) for n in np.unique(self.data[what].values.astype(str))] if what in self.data else []
            text = f"{what} '{{}}' is not in the scene; {{}}".format
            problems.add_unknown(self.source, filter(None, used), names, text)
        problems.raise_if_any()


_DIMENSIONS = {
    "action": ("frame",),
    "step": ("frame",),
    "time": ("frame",),
    "grasp": ("frame",),
    "position": ("frame", "fiducial", "axis"),
    "translation": ("frame", "axis"),
    "rotation": ("frame", "quaternion"),
}


def _in_order(data: xr.Dataset, problems: Problems, source: str) -> xr.Dataset:
    """The dataset with every variable's dimensions in the usual order; what is missing is noted."""
    for name in ("fiducial", "axis"):
        if name not in data.coords:
            problems.add(source, f"coordinate '{name}' is missing")
    for name, dimensions in _DIMENSIONS.items():
        if name not in data:
            problems.add(source, f"variable '{name}' is missing")
        elif set(data[name].dims) != set(dimensions):
            problems.add(source, f"variable '{name}' has dimensions {data[name].dims}, expected {dimensions}")
    if problems.found or data.sizes["frame"] == 0 or data.sizes["axis"] != 3 or data.sizes["quaternion"] != 4:
        problems.add(source, "expected at least one frame, three axes and four components of a quaternion")
        problems.raise_if_any()
    return data.transpose("frame", "fiducial", "axis", "quaternion", ...)


def scaled(scene: Scene, measurement: Contents) -> Scene:
    """A scene with what a measurement states of the length of a pixel, which is taken before what the scene does."""
    known = scene.uncertainty
    sigma = known.scale if measurement.scale_sigma is None else measurement.scale_sigma
    too = known.scale_of_gripper or measurement.scale_of_gripper
    return replace(scene, uncertainty=replace(known, scale=sigma, scale_of_gripper=too))


def _check_scale(scene: Scene, measurement: Contents, problems: Problems) -> None:
    """Note where scene and measurement contradict each other in what they say of the length of a pixel."""
    known, source = scene.uncertainty, measurement.source
    stated = measurement.scale_sigma
    if stated is not None and known.scale == 0:
        problems.add(
            source,
            f"scale_sigma is {stated:g}, but [uncertainty] of the scene says scale = 0: its lengths share no factor with pictures. "
            "Leave scale out of the scene where they do; otherwise leave scale_sigma out, and state the scale of the "
            "positions alone in frame.toml",
        )
    if measurement.scale_of_gripper and known.scale_of_gripper is False:
        problems.add(
            source,
            "the gripper's path was measured in the pictures (scale_of_gripper), but [uncertainty] of the scene says "
            "scale_of_gripper = false; leave one of them out",
        )
    error = measurement.frame_error
    if error is not None and error.covariance[6, 6] > 0 and scaled(scene, measurement).uncertainty.scale:
        problems.add(
            source,
            "the scale is stated twice: of the positions alone by the error of the frame (last element of its covariance, "
            f"{error.covariance[6, 6]:.2g}), and of all lengths from pictures (scale of [uncertainty], or scale_sigma). Set the "
            "last row and column of the covariance to 0 where body and fiducials were measured in the same pictures; otherwise "
            "leave the other out",
        )
