"""Record trials in bags, and read bags."""

BAGS = "bags"  # folder of bags among the results of a run
