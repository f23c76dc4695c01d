"""`python -m barn_eval` is `barn`."""

from barn_eval.commands.main import main

main()
