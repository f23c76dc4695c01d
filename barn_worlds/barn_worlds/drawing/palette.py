"""The colours of all that is drawn: figures, pages, films and pictures of worlds, each named by what it stands for.

Hues are Okabe and Ito's, which colour-blind readers can tell apart and which differ in lightness as well.
"""

BLUE, ORANGE, PINK, SKY, GREEN, VERMILION = "#0072B2", "#E69F00", "#CC79A7", "#56B4E9", "#009E73", "#D55E00"
YELLOW, GREY, WHITE = "#F0E442", "#7F7F7F", "#ffffff"
# Planners take these in their order; yellow is left out, it is lost on white.
PLANNERS = (BLUE, ORANGE, PINK, SKY, GREEN, VERMILION, GREY)

# A scene.
START, GOAL, ROUTE = BLUE, GREEN, VERMILION
OBSTACLE, WALL, HOLLOW, INFLATED, UNKNOWN = "#33373d", "#8b919b", "#5a5a5a", "#cfe2f3", "#c9ced6"
MOVER, MOVER_ON_TRACK = "#7b5a8c", PINK  # the latter where its track is drawn below it
# A trial in it.
ROBOT, TRAIL, CONTACT, SCAN = ORANGE, BLUE, "#b84600", VERMILION
PLAN, LOCAL_PLAN, BAND, CANDIDATE = GREEN, PINK, SKY, "#8a8f98"
# A figure: black takes the colour of a page's text.
INK, FAINT, NO_TRIAL = "#010101", "#8a8f98", "#b8bcc4"

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
PLANNERS_ON_DARK = dict(
    zip(PLANNERS, ("#5db4ea", "#f0b429", "#e9a5cc", "#b4dffa", "#35c79c", "#ff8a4c", "#b0b0b0"), strict=True)
)
