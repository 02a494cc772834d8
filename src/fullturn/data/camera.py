"""Pinhole cameras, and how to place many of them around an object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fullturn.data.motion import uniform_rotation
from fullturn.errors import InputError
from fullturn.geometry.directions import sphere_directions
from fullturn.geometry.motion import invert, rigid

# Within this angle of the object's z axis, a line of sight has no stable "up" along z.
_POLAR_DEG = 5.0


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: x to the right, y down, z forward.

    Pixel (u, v), in column u and row v, is seen along ((u + ½ − w/2)/f, (v + ½ − h/2)/f, 1).

    Raises:
        InputError: no rigid motion, no positive focal length, or an image without pixels.
    """

    T_camera_object: Float[np.ndarray, "4 4"]
    focal: float  # in pixels
    width: int
    height: int

    def __post_init__(self) -> None:
        R = self.T_camera_object[:3, :3]
        if not (
            np.isfinite(self.T_camera_object).all()
            and np.allclose(R @ R.T, np.eye(3), atol=1e-6)
            and np.linalg.det(R) > 0.0
        ):
            raise InputError(
                "T_camera_object: expected a rigid 4×4 motion, got another matrix; "
                "orthonormalize its rotation"
            )
        if not (0.0 < self.focal < math.inf) or self.width < 1 or self.height < 1:
            raise InputError(
                "expected a focal length above 0 and an image of at least 1×1 pixels, got "
                f"{self.focal} and {self.width}×{self.height}; change them"
            )

    @property
    def center(self) -> Float[np.ndarray, "3"]:
        """The eye, in the object's frame."""
        return invert(self.T_camera_object)[:3, 3]

    def rays(self) -> Float[np.ndarray, "h w 3"]:
        """The direction of each pixel in the camera's frame, scaled to z = 1."""
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal
        rays[..., 1] = ((np.arange(self.height) + 0.5 - self.height / 2) / self.focal)[:, None]
        return rays


def look_at(
    eye: Float[np.ndarray, "3"],
    at: Float[np.ndarray, "3"],
    *,
    fov_deg: float = 60.0,
    width: int = 160,
    height: int = 160,
) -> Camera:
    """A camera at `eye` that has the point `at` in the middle of its image.

    `fov_deg` is the angle across the shorter side of the image. The object's z axis points up in
    the image; where the line of sight is nearly along z, its y axis does.

    >>> camera = look_at(np.array([0.0, -3.0, 0.0]), np.zeros(3))
    >>> camera.T_camera_object @ [0.0, 0.0, 1.0, 1.0]  # the top of an object: up is -y
    array([ 0., -1.,  3.,  1.])

    Raises:
        InputError: two equal points, or an angle that is not between 0° and 180°.
    """
    forward = at - eye
    distance = float(np.linalg.norm(forward))
    if not 0.0 < distance < math.inf:
        raise InputError(
            f"expected an eye and another, finite point to look at, got {eye} and {at}; "
            "move one of them"
        )
    if not 0.0 < fov_deg < 180.0:
        raise InputError(f"fov_deg: expected an angle between 0° and 180°, got {fov_deg}")
    forward = forward / distance
    polar = abs(forward[2]) > math.cos(math.radians(_POLAR_DEG))
    right = np.cross(forward, np.eye(3)[1 if polar else 2])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal = min(width, height) / 2 / math.tan(math.radians(fov_deg) / 2)
    return Camera(rigid(R, -R @ eye), focal, width, height)


def ball_camera(
    center: Float[np.ndarray, "3"],
    radius: float,
    direction: Float[np.ndarray, "3"],
    *,
    distance: float,
    width: int,
    height: int,
) -> Camera:
    """A camera `distance` radii away, in a direction, whose shorter side just holds the ball."""
    return look_at(
        center + distance * radius * direction,
        center,
        fov_deg=math.degrees(2.0 * math.asin(1.0 / distance)),
        width=width,
        height=height,
    )


def cameras_around(
    center: Float[np.ndarray, "3"],
    radius: float,
    *,
    count: int,
    distance: float,
    rng: np.random.Generator,
    width: int = 160,
    height: int = 160,
    above: bool = False,
) -> list[Camera]:
    """Cameras that look at a ball from evenly spread directions: a lattice, randomly turned.

    The eyes are `distance` radii away from the center, and the shorter side of the image just
    holds the ball. With `above`, all eyes are higher than the center, and only the turn about z is
    random.

    Raises:
        InputError: no ball, a `distance` of 1 or less (inside the ball), or no camera asked for.
    """
    if not (0.0 < radius < math.inf and np.isfinite(center).all()):
        raise InputError(
            f"expected a ball with a finite center and a radius above 0, got {center} and {radius}"
        )
    if not 1.0 < distance < math.inf:
        raise InputError(
            f"distance: expected more than 1 radius, so that the eye is outside, got {distance}"
        )
    if above:
        turn = Rotation.from_euler("z", rng.uniform(0.0, 360.0), degrees=True).as_matrix()
        directions = sphere_directions(2 * count)[:count] @ turn.T
    else:
        directions = sphere_directions(count) @ uniform_rotation(rng).T
    return [
        ball_camera(center, radius, direction, distance=distance, width=width, height=height)
        for direction in directions
    ]


def bounding_ball(points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """A ball that holds all points: around the middle of their box, out to the farthest of them."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())
