"""Two result folders, paired: answers, step times, the evidence behind a difference."""
