"""What is used most, at the top of `barn_eval`."""

from barn_eval.api import plan as plan
from barn_eval.api import run as run
from barn_eval.api import sweep as sweep
from barn_eval.results import Results as Results
from barn_eval.results import compare as compare
from barn_eval.results import load as load
from barn_eval.results import replay as replay
from barn_eval.results import report as report
