"""What results say: statistics, measures, comparisons and rankings."""
