"""The paper's trials and analyses, run again and written up beside its numbers."""
