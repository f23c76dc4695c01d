"""The paper reproduced: its trials, its model and its experiment on new worlds, ours beside the published numbers."""
