"""`python -m barn_eval` is `barn`."""

from barn_eval.cli import main

main()
