"""One camera in front of a body: light, the beads it sees, and its picture without noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.vision.images import Image
from validation.rendering.appearance import Appearance
from validation.rendering.blockers import SEEN, Blockers
from validation.rendering.footprint import Footprint, Grey
from validation.rendering.lens import Lens
from validation.rendering.rig import Pose
from validation.rendering.shot import Plane, Shot
from validation.rendering.vectors import dot, unit

Array = NDArray[np.float64]

# Sharpness of highlights.
_SHINE = 24.0


class View:
    """One camera in front of the body.

    Args:
        lens: of the camera.
        pose: of the body's frame in the camera's.
        lamp, middle: positions of the lamp and of what it lights with the strength stated, shape (3,), body frame, m.
        floor: the background, body frame.
        appearance: what the picture looks like.
    """

    def __init__(
        self, lens: Lens, pose: Pose, lamp: Array, middle: Array, floor: Plane, appearance: Appearance
    ) -> None:
        self.lens, self.pose, self.appearance = lens, pose, appearance
        self._lamp = self.of(lamp)
        self._reach = float(np.linalg.norm(self.of(middle) - self._lamp))
        self._floor = self._lit(*floor)

    def _lit(self, point: Array, normal: Array) -> Grey:
        """Grey levels (height, width) of the background."""
        point, normal = self.of(point), self.pose[0] @ normal
        shape = self.lens.rays.shape[:2]
        rays = np.concatenate([self.lens.rays, np.ones((*shape, 1))], axis=-1).reshape(-1, 3)
        facing = rays @ normal
        seen = (facing < 0) & (point @ normal < 0)
        ahead = np.where(seen, point @ normal / np.where(seen, facing, 1.0), 1.0)
        lit = self.shade(ahead[:, None] * rays, normal, self.appearance.background)
        plain = 255 * self.appearance.ambient * self.appearance.background
        return np.asarray(np.where(seen, lit, min(plain, 255)).reshape(shape).astype(np.float32))

    def of(self, points: Array) -> Array:
        """Points (..., 3) of the body frame in the camera's frame."""
        return np.asarray(points @ self.pose[0].T + self.pose[1])

    def shade(self, points: Array, normals: Array, grey: float, gloss: float = 0.0) -> Array:
        """Grey levels (n,), 0 to 255, of a surface at points (n, 3) with unit normals (n, 3), camera frame.

        Phong's ambient, diffuse and specular light (CACM 18, 1975) in Blinn's form (SIGGRAPH 1977); the lamp's light falls off
        with the square of the distance.
        """
        appearance = self.appearance
        away = self._lamp - points
        far = np.linalg.norm(away, axis=-1)
        light = appearance.strength * (self._reach / far) ** 2
        cosine = np.clip(dot(normals, away) / far, 0, None)
        value = grey * (appearance.ambient + light * cosine)
        if gloss > 0:
            half = unit(away / far[..., None] - unit(points))
            value = value + gloss * light * (cosine > 0) * np.clip(dot(normals, half), 0, None) ** _SHINE
        return np.asarray(np.clip(255 * value, 0, 255))

    def picture(self, drawn: Image, shot: Shot, decoys: Array) -> tuple[Grey, NDArray[np.bool_], Array]:
        """The picture (height, width), grey levels; which beads are visible (k,); where they are (k, 2), px.

        Args:
            drawn: grey and cover of the pinhole picture, see `Stage.draw`.
            decoys: centres of more beads, shape (n, 3), body frame, m.
        """
        grey, cover = np.moveaxis(self.lens.bent(drawn), -1, 0)
        picture = grey + (1 - cover / np.float32(255)) * self._floor
        balls = self.of(np.concatenate([shot.beads, decoys]))
        pixels = self.lens.camera.project(balls)
        blockers = Blockers(shot, self.pose)
        seen = np.array([self._paint(picture, balls, i, pixel, blockers) for i, pixel in enumerate(pixels)])
        return picture, seen[: len(shot.beads)], pixels[: len(shot.beads)]

    def _paint(self, picture: Grey, balls: Array, number: int, pixel: Array, blockers: Blockers) -> bool:
        """Paint one of the beads with centres `balls` (k, 3), camera frame, into the picture; whether it is visible."""
        ball, others = balls[number], np.delete(balls, number, axis=0)
        spot = Footprint.of(self.lens.camera, ball, pixel, self.appearance)
        if spot is None:
            return False
        radius, count = self.appearance.radius, self.appearance.supersampling
        rays, cover = spot.cover(ball, radius)
        on = cover > 0
        if not on.any():
            return False
        faces = _front(rays[on], ball, radius)
        # Only a bead beside the line of sight that is nearer can be in front.
        beside = np.linalg.norm(np.cross(others, unit(ball)), axis=1) < 2.5 * radius
        nearer = others[beside & (np.linalg.norm(others, axis=1) < np.linalg.norm(ball))]
        free = np.zeros(on.shape)
        free[on] = cover[on] * ~blockers.hide(faces * (1 - 1e-6), nearer, radius)
        inside = np.repeat(np.repeat(spot.inside(self.lens.camera.size), count, axis=0), count, axis=1)
        grey = np.zeros(on.shape)
        grey[on] = self.shade(faces, unit(faces - ball), self.appearance.bead, self.appearance.specular)
        spot.blend(picture, _binned(free * grey, count), _binned(free, count))
        return bool((free * inside).sum() >= SEEN * cover.sum())


def _front(rays: Array, ball: Array, radius: float) -> Array:
    """Where rays (n, 3) meet the near face of a ball, or the nearest point of those that just miss it; shape (n, 3)."""
    a, b, c = dot(rays, rays), rays @ ball, ball @ ball - radius**2
    return np.asarray(((b - np.sqrt(np.clip(b * b - a * c, 0, None))) / a)[:, None] * rays)


def _binned(values: Array, count: int) -> Array:
    """Means over squares of count x count values."""
    width = len(values) // count
    return np.asarray(values.reshape(width, count, width, count).mean(axis=(1, 3)))
