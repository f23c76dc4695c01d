"""The colors of everything that is drawn, each named by what it stands for.

Hues of scenes are Okabe and Ito's, which color-blind readers can tell apart. Planners
and outcomes have a contrast of 3:1 to the paper (WCAG 2.2, 1.4.11) and are at least 15
apart by CIEDE2000, for readers with deuteranopia too.
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

# How a trial ended.
SUCCEEDED = "#419979"
COLLIDED = "#8a0010"
TIMED_OUT = "#8c7433"
UNMOVED = "#5132ae"
BROKEN = "#555153"

# Planners take these in order, dark and light in turn.
PLANNERS = ("#2f5fca", "#e86011", "#091614", "#9c5372", "#653d2d", "#698db0", "#2a2a60")

# What planners and outcomes are on dark paper, by their color on white.
ON_DARK = {
    SUCCEEDED: "#6d9c72",
    COLLIDED: "#d92e23",
    TIMED_OUT: "#f5f05a",
    UNMOVED: "#a47daf",
    BROKEN: "#b8b8b8",
    "#2f5fca": "#52a4e4",
    "#e86011": "#f87a26",
    "#091614": "#dafed2",
    "#9c5372": "#d57c9b",
    "#653d2d": "#966b50",
    "#698db0": "#b5e2ff",
    "#2a2a60": "#785ad0",
}

# A page on white and on dark paper. Its style sheet has its other colors.
PAPER = (WHITE, "#15171b")
PANEL = ("#f5f6f8", "#1e2127")
PAGE_INK = "#1a1c20"
