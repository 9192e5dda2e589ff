"""Colours: of parts, and between light and sRGB."""

from __future__ import annotations

import numpy as np

from pwralign_kin.arrays import Image, Singles
from pwralign_kin.se3 import Array

_OKLAB_TO_LMS = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)

_LMS_TO_LINEAR = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def part_colours(count: int) -> Array:
    """Return (count, 3) sRGB colours in [0, 1], easy to tell apart, neighbours in the list most of all.

    Hues follow the golden angle in the OKLCH space (Ottosson, 2020, "A perceptual color space for image
    processing"). It comes back near an earlier hue after 8 and 13 steps; then the lightness differs.
    """
    index = np.arange(count)
    lightness = 0.67 + 0.042 * np.array([0, 4, 3, 2, 1])[index % 5]
    hue = np.radians(250.0 + 137.50776 * index)
    chroma = 0.105
    lms = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1) @ _OKLAB_TO_LMS.T
    return _to_srgb(np.clip(lms**3 @ _LMS_TO_LINEAR.T, 0.0, 1.0))


def as_bytes(linear: Singles) -> Image:
    """Return linear light as sRGB bytes."""
    levels = np.rint(255.0 * _to_srgb(np.arange(4096) / 4095.0)).astype(np.uint8)
    return np.asarray(levels[np.rint(4095.0 * np.clip(linear, 0.0, 1.0)).astype(np.int16)])


def _to_srgb(linear: Array) -> Array:
    """Return linear light in [0, 1] encoded as sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1.0 / 2.4) - 0.055)


def to_linear(srgb: Array) -> Array:
    """Return sRGB in [0, 1] decoded to linear light (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
