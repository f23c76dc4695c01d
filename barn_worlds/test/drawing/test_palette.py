"""Colors of planners and of outcomes, on white and on dark paper.

They are seen on it and told apart, also by readers with deuteranopia.
"""

import numpy as np
import pytest
import yaml
from matplotlib.colors import to_rgb

from barn_worlds.drawing import palette

OUTCOMES = (
    palette.SUCCEEDED,
    palette.COLLIDED,
    palette.TIMED_OUT,
    palette.UNMOVED,
    palette.BROKEN,
)
FAMILIES = {"planners": palette.PLANNERS, "outcomes": OUTCOMES}
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
# Machado, Oliveira and Fernandes 2009, deuteranomaly of severity 1, of linear RGB.
DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)


def linear(color):
    """Linear RGB of a hexadecimal color of sRGB."""
    rgb = np.array(to_rgb(color))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def contrast(color, paper):
    """The contrast ratio of two colors by WCAG 2.2."""
    low, high = sorted(float(TO_XYZ[1] @ linear(one)) for one in (color, paper))
    return (high + 0.05) / (low + 0.05)


def lab(rgb):
    """CIELAB under D65 of linear RGB."""
    x, y, z = (
        np.cbrt(t) if t > (6 / 29) ** 3 else t / (3 * (6 / 29) ** 2) + 4 / 29
        for t in (TO_XYZ @ np.clip(rgb, 0, 1)) / TO_XYZ.sum(axis=1)
    )
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def difference(one, other):
    """CIEDE2000 of two colors of CIELAB, as Sharma, Wu and Dalal 2005 write it."""
    chroma = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    stretch = 1.5 - 0.5 * np.sqrt(chroma**7 / (chroma**7 + 25**7))
    (la, ca, ha), (lb, cb, hb) = (
        (c[0], np.hypot(stretch * c[1], c[2]), np.arctan2(c[2], stretch * c[1]))
        for c in (one, other)
    )
    turn = (hb - ha + np.pi) % (2 * np.pi) - np.pi if ca * cb else 0.0
    hue = np.degrees(ha + turn / 2) if ca * cb else np.degrees(ha + hb)
    light, chroma = (la + lb) / 2, (ca + cb) / 2
    terms = ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.2, 4, -63))
    weight = 1 + sum(k * np.cos(np.radians(n * hue + at)) for k, n, at in terms)
    bend = 60 * np.exp(-((((hue - 275 + 180) % 360 - 180) / 25) ** 2))
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25**7)) * np.sin(np.radians(bend))
    parts = (
        (lb - la) / (1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)),
        (cb - ca) / (1 + 0.045 * chroma),
        2 * np.sqrt(ca * cb) * np.sin(turn / 2) / (1 + 0.015 * chroma * weight),
    )
    return np.sqrt(np.dot(parts, parts) + rotation * parts[1] * parts[2])


DIFFERENCES = """
- [[50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425]
- [[50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492]
- [[60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644]
- [[22.7233, 20.0904, -46.6940], [23.0331, 14.9730, -42.5619], 2.0373]
- [[2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082]
"""


@pytest.mark.parametrize("one, other, expected", yaml.safe_load(DIFFERENCES))
def test_the_difference_is_that_of_its_authors(one, other, expected):
    assert difference(one, other) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("theme", [0, 1], ids=["white", "dark"])
@pytest.mark.parametrize("family", FAMILIES)
def test_colors_are_seen_and_told_apart(family, theme):
    colors = [(one, palette.ON_DARK[one])[theme] for one in FAMILIES[family]]
    for paper in (palette.PAPER, palette.PANEL):
        assert min(contrast(color, paper[theme]) for color in colors) >= 3.0
    for vision in (np.eye(3), DEUTERANOPIA):
        seen = [lab(vision @ linear(color)) for color in colors]
        pairs = [(a, b) for place, a in enumerate(seen) for b in seen[:place]]
        assert min(difference(*pair) for pair in pairs) >= 15.0
