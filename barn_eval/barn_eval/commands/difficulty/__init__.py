"""`barn difficulty`: train, judge and use the learned difficulty of worlds."""

from barn_eval.commands.group import LazyGroup

COMMANDS = {
    "train": "Train a model on trials and write its weights.",
    "evaluate": "Judge models, or weights, on worlds that they were not trained on.",
    "predict": "Predict how difficult worlds are.",
}

command = LazyGroup(
    "difficulty",
    __name__,
    COMMANDS,
    "Train, judge and use a model of how difficult worlds are.\n\n"
    "Difficulty is the normalised time of trials: seconds per metre of path, failures as they count, averaged over"
    " planners and repetitions.",
)
