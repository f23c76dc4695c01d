"""Draw the plan of a small office as a map of map_server: python examples/office_map.py out/office.yaml."""

import sys
from pathlib import Path

from PIL import Image, ImageDraw

CELL_M, WIDTH_M, HEIGHT_M = 0.05, 12.0, 8.0
WALLS = [  # x, y, x, y of their ends in metres
    (0, 0, 12, 0), (12, 0, 12, 8), (12, 8, 0, 8), (0, 8, 0, 0),
    (0, 3.2, 1.0, 3.2), (2.0, 3.2, 5.4, 3.2), (6.4, 3.2, 9.6, 3.2), (10.6, 3.2, 12, 3.2),  # rooms below the corridor
    (4, 0, 4, 3.2), (8, 0, 8, 3.2),
    (0, 4.8, 2.6, 4.8), (3.6, 4.8, 8.4, 4.8), (9.4, 4.8, 12, 4.8), (6, 4.8, 6, 8),  # and above it
]  # fmt: skip
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
    plan = Image.new("L", (round(WIDTH_M / CELL_M), round(HEIGHT_M / CELL_M)), 254)
    draw = ImageDraw.Draw(plan)
    for wall in WALLS:
        draw.line(pixels(wall), fill=0, width=3)
    for left, below, right, above in DESKS:
        draw.rectangle(pixels((left, above, right, below)), fill=0)
    target.parent.mkdir(parents=True, exist_ok=True)
    plan.save(target.with_suffix(".pgm"))
    target.write_text(
        f"image: {target.stem}.pgm\nresolution: {CELL_M}\norigin: [0.0, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        "start: [2.5, 1.0, 1.57]\ngoal: [11.0, 5.6]\n"
    )


def pixels(metres: tuple[float, ...]) -> list[int]:
    """Return x and y in metres as columns and rows of the image, whose first row is at the top."""
    return [
        round((HEIGHT_M - at if place % 2 else at) / CELL_M)
        for place, at in enumerate(metres)
    ]


if __name__ == "__main__":
    main()
