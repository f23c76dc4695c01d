"""The BARN paper from one command: data set, trials, difficulty model and transfer experiment, beside its numbers."""
