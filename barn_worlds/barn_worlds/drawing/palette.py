"""The colors of everything that is drawn, each named by what it stands for.

Hues of scenes are Okabe and Ito's, which color-blind readers can tell apart. Planners
are dark and light in turn: each has a contrast of 3:1 to the paper, and a dark one 3:1
to a light one (WCAG 2.2, 1.4.11).
"""

BLUE = "#0072B2"
ORANGE = "#E69F00"
PINK = "#CC79A7"
SKY = "#56B4E9"
GREEN = "#009E73"
VERMILION = "#D55E00"
WHITE = "#ffffff"

# A scene.
START = BLUE
GOAL = GREEN
ROUTE = VERMILION
OBSTACLE = "#33373d"
WALL = "#8b919b"
HOLLOW = "#5a5a5a"
INFLATED = "#cfe2f3"
UNKNOWN = "#c9ced6"
MOVER = "#7b5a8c"
# Where the obstacle's track is drawn below it.
MOVER_ON_TRACK = PINK

# A trial in it.
ROBOT = ORANGE
TRAIL = BLUE
CONTACT = "#b84600"
SCAN = VERMILION
PLAN = GREEN
LOCAL_PLAN = PINK
BAND = SKY
CANDIDATE = "#8a8f98"

# A figure. A page replaces this black by the color of its text.
INK = "#010101"
FAINT = "#8a8f98"

# How a trial ended: light where it succeeded, dark where it failed.
SUCCEEDED = "#25a48f"
COLLIDED = "#8c1d04"
TIMED_OUT = "#241a6b"
UNMOVED = "#6a1a6a"
BROKEN = "#474747"

# Planners on dark paper, by their color on white. They take these in order.
PLANNERS_ON_DARK = {
    "#0A38A8": "#4a63ea",
    "#EE6A18": "#ffbe73",
    "#7D1F08": "#cd2a20",
    "#25A48F": "#6ff0d0",
    "#1D1030": "#8a5a94",
    "#C96CF1": "#e3b5ff",
    "#513159": "#56808a",
}
PLANNERS = tuple(PLANNERS_ON_DARK)

# A page, by property of its style sheet: on white and on dark paper. Print is on white.
PAGE = {
    "paper": (WHITE, "#15171b"),
    "panel": ("#f5f6f8", "#1e2127"),
    "ink": ("#1a1c20", "#e8eaee"),
    "soft": ("#5b6270", "#a3aab6"),
    "line": ("#d5d9e0", "#363b45"),
    "accent": (BLUE, "#6bb8ea"),
    "good": ("#007a58", "#38c49a"),
    "bad": (CONTACT, "#f58a4b"),
    "obstacle": (OBSTACLE, "#aeb4be"),
    "wall": (WALL, "#6d7480"),
    "mover": (MOVER, "#b795cc"),
    "map": (OBSTACLE, "#aeb4be"),
    "unknown": (UNKNOWN, "#2c3038"),
    "robot": (ROBOT, "#f0b429"),
    "trail": (TRAIL, "#6bb8ea"),
    "scan": (SCAN, "#ff8a4c"),
    "plan": (PLAN, "#35c79c"),
    "local": (LOCAL_PLAN, "#e39cc6"),
    "band": (BAND, "#7cc8f2"),
    "candidate": (CANDIDATE, "#7d838e"),
    "cost": ("#8e7cc3", "#a594d6"),
}
