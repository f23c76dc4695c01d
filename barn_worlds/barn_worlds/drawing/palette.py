"""The colours of all that is drawn: figures, pages, films and pictures of worlds, each named by what it stands for.

Hues of scenes are Okabe and Ito's, which colour-blind readers can tell apart. Planners are dark and light in turn: each
has 3:1 against the paper, and a dark one 3:1 against a light one (WCAG 2.2, 1.4.11).
"""

BLUE, ORANGE, PINK, SKY, GREEN, VERMILION = (
    "#0072B2",
    "#E69F00",
    "#CC79A7",
    "#56B4E9",
    "#009E73",
    "#D55E00",
)
WHITE = "#ffffff"
# Planners take these in their order, on white; below, the same on dark paper.
PLANNERS = ("#0A38A8", "#EE6A18", "#7D1F08", "#25A48F", "#1D1030", "#C96CF1", "#513159")
_PLANNERS_ON_DARK = (
    "#4a63ea",
    "#ffbe73",
    "#cd2a20",
    "#6ff0d0",
    "#8a5a94",
    "#e3b5ff",
    "#56808a",
)

# A scene.
START, GOAL, ROUTE = BLUE, GREEN, VERMILION
OBSTACLE, WALL, HOLLOW, INFLATED, UNKNOWN = (
    "#33373d",
    "#8b919b",
    "#5a5a5a",
    "#cfe2f3",
    "#c9ced6",
)
MOVER, MOVER_ON_TRACK = "#7b5a8c", PINK  # the latter where its track is drawn below it
# A trial in it.
ROBOT, TRAIL, CONTACT, SCAN = ORANGE, BLUE, "#b84600", VERMILION
PLAN, LOCAL_PLAN, BAND, CANDIDATE = GREEN, PINK, SKY, "#8a8f98"
# A figure: black takes the colour of a page's text.
INK, FAINT = "#010101", "#8a8f98"
# How a trial ended: light where it succeeded, dark where it failed, white where there was none.
SUCCEEDED, COLLIDED, TIMED_OUT, UNMOVED, BROKEN = (
    "#25a48f",
    "#8c1d04",
    "#241a6b",
    "#6a1a6a",
    "#474747",
)

# Of a page, by the name of its style sheet's property: on white and on dark paper. Print is on white.
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
# What a planner's colour is on dark paper.
PLANNERS_ON_DARK = dict(zip(PLANNERS, _PLANNERS_ON_DARK, strict=True))
