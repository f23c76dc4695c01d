"""Worlds: data sets, generated worlds, files for other programs, pictures, and the five difficulty metrics."""

from barn_eval.worlds.generated import generate as generate
from barn_eval.worlds.generated import generate_moving as generate_moving
from barn_eval.worlds.generated import sample as sample
from barn_eval.worlds.measured import metrics as metrics
from barn_eval.worlds.measured import motion as motion
from barn_eval.worlds.sets import datasets as datasets
from barn_eval.worlds.sets import draw as draw
from barn_eval.worlds.sets import load as load
from barn_eval.worlds.sets import order as order
from barn_eval.worlds.sets import resize as resize
from barn_eval.worlds.sets import save as save
from barn_eval.worlds.sets import write_figure as write_figure
