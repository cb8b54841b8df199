"""Vehicles on the simulated road: boxes, drawn ray by ray into a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.vision.camera.model import Camera, axes
from egolane_pgm.vision.camera.picture import Image

#: How much brighter than its paint a vehicle is in each square of 0.1 m, to tell them apart.
_DIRT = np.random.default_rng(1).uniform(-0.2, 0.2, (64, 64))


@dataclass(frozen=True)
class Vehicle:
    """A box on the road with a bright stripe along its sides, which looks like a line.

    rear_m: ahead; middle_m: to the right; grey: its brightness.
    """

    rear_m: float
    middle_m: float
    length_m: float
    width_m: float
    height_m: float
    grey: float


def car(rear_m: float, middle_m: float, grey: float = 28.0) -> Vehicle:
    return Vehicle(rear_m, middle_m, 4.5, 1.8, 1.6, grey)


def lorry(rear_m: float, middle_m: float) -> Vehicle:
    return Vehicle(rear_m, middle_m, 14.0, 2.5, 3.6, 100.0)


def with_vehicles(
    image: Image, camera: Camera, vehicles: Sequence[Vehicle]
) -> tuple[Image, NDArray[np.bool_]]:
    """The picture with vehicles, the farthest drawn first, and where they are in it, (H, W)."""
    image, is_there = image.copy(), np.zeros(image.shape[:2], dtype=bool)
    for one in sorted(vehicles, key=lambda vehicle: -vehicle.rear_m):
        for shade, where, place in _sides(camera, one):
            across, up = (np.floor(np.where(where, d, 0) / 0.1).astype(int) % 64 for d in place)
            paint = np.where((place[1] > 0.3) & (place[1] < 0.36), 225.0, one.grey * shade)
            grey = np.clip(paint * (1 + _DIRT[across, up]), 0, 255).astype(np.uint8)
            image[where] = grey[where][:, None]
            is_there |= where
    return image, is_there


def _sides(
    camera: Camera, one: Vehicle
) -> list[tuple[float, NDArray[np.bool_], tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    """Its side and its rear as far as they are seen: shade, pixels, and their places on it."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    right, down, ahead = axes(camera)
    a, b = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    ray = a[..., None] * right + b[..., None] * down + ahead
    at = np.array([0.0, camera.lateral_m, camera.height_m])
    left, end = one.middle_m - one.width_m / 2, one.rear_m + one.length_m
    found = []
    beside = left if left > at[1] else left + one.width_m
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (beside - at[1]) / ray[..., 1]
        x, z = at[0] + reach * ray[..., 0], at[2] + reach * ray[..., 2]
        near = max(one.rear_m, 0.5)
        is_side = (reach > 0) & (x > near) & (x < end) & (z > 0) & (z < one.height_m)
        found.append((0.75, is_side, (x, z)))
        reach = (one.rear_m - at[0]) / ray[..., 0]
        y, z = at[1] + reach * ray[..., 1], at[2] + reach * ray[..., 2]
        is_rear = (reach > 0) & (y > left) & (y < left + one.width_m) & (z > 0) & (z < one.height_m)
        found.append((0.95, is_rear, (y, z)))
    return found
