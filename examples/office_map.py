"""Draw a small office as a map of map_server.

python examples/office_map.py out/office.yaml
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw

CELL_M = 0.05
WIDTH_M = 12.0
HEIGHT_M = 8.0
FREE = 254
OCCUPIED = 0
# Walls: x and y of one end, x and y of the other, in m.
OUTER_WALLS = [(0, 0, 12, 0), (12, 0, 12, 8), (12, 8, 0, 8), (0, 8, 0, 0)]
WALLS_BELOW_CORRIDOR = [
    (0, 3.2, 1.0, 3.2),
    (2.0, 3.2, 5.4, 3.2),
    (6.4, 3.2, 9.6, 3.2),
    (10.6, 3.2, 12, 3.2),
    (4, 0, 4, 3.2),
    (8, 0, 8, 3.2),
]
WALLS_ABOVE_CORRIDOR = [
    (0, 4.8, 2.6, 4.8),
    (3.6, 4.8, 8.4, 4.8),
    (9.4, 4.8, 12, 4.8),
    (6, 4.8, 6, 8),
]
# Desks: left, bottom, right and top in m.
DESKS = [
    (0.6, 0.6, 1.4, 2.0),
    (5.0, 0.5, 7.0, 1.2),
    (9.2, 1.0, 10.0, 2.4),
    (1.6, 6.2, 3.4, 7.0),
    (8.4, 6.2, 10.4, 7.0),
]


def main() -> None:
    """Write the image and, beside it, the YAML file with start and goal."""
    target = Path(sys.argv[1])
    size = (round(WIDTH_M / CELL_M), round(HEIGHT_M / CELL_M))
    image = Image.new("L", size, FREE)
    draw = ImageDraw.Draw(image)
    for x, y, end_x, end_y in OUTER_WALLS + WALLS_BELOW_CORRIDOR + WALLS_ABOVE_CORRIDOR:
        draw.line([to_pixel(x, y), to_pixel(end_x, end_y)], fill=OCCUPIED, width=3)
    for left, bottom, right, top in DESKS:
        draw.rectangle([to_pixel(left, top), to_pixel(right, bottom)], fill=OCCUPIED)

    target.parent.mkdir(parents=True, exist_ok=True)
    image.save(target.with_suffix(".pgm"))
    target.write_text(
        f"image: {target.stem}.pgm\n"
        f"resolution: {CELL_M}\n"
        "origin: [0.0, 0.0, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
        "start: [2.5, 1.0, 1.57]\n"
        "goal: [11.0, 5.6]\n"
    )


def to_pixel(x_m: float, y_m: float) -> tuple[int, int]:
    """Return column and row of a point; the first row of the image is at the top.

    Args:
        x_m: Distance from the left end of the office in m.
        y_m: Distance from its bottom end in m.
    """
    return round(x_m / CELL_M), round((HEIGHT_M - y_m) / CELL_M)


if __name__ == "__main__":
    main()
