"""Results of experiments: tables, trials, comparisons, figures, replays and reports of what is in their folders."""

from barn_eval.api.results.folders import check as check
from barn_eval.api.results.folders import compare as compare
from barn_eval.api.results.folders import leaderboard as leaderboard
from barn_eval.api.results.folders import overlay as overlay
from barn_eval.api.results.folders import replay as replay
from barn_eval.api.results.folders import report as report
from barn_eval.api.results.folders import watch as watch
from barn_eval.api.results.results import Results as Results
from barn_eval.api.results.results import load as load
from barn_eval.api.results.trial import Trial as Trial
from barn_eval.verification.submission import submit as submit
from barn_eval.verification.submission import verify as verify
