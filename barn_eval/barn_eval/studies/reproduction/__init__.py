"""Run the paper's trials and analyses again and report them beside its numbers."""
