"""Numbers from records: verdicts, step times, comparisons; no words, no drawing."""
