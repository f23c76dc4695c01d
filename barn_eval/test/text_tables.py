"""Cases of tests that read best as lines of text."""


def rows_of(text):
    """Return the cells of each line of a table, whose columns `|` parts."""
    lines = text.strip().splitlines()
    return [[cell.strip() for cell in line.split("|")] for line in lines]


def answers_of(text):
    """Return pairs of lines: what is said, and the answer in the line below it."""
    lines = [line.strip() for line in text.strip().splitlines()]
    return list(zip(lines[::2], lines[1::2], strict=True))
