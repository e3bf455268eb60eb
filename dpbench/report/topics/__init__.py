"""Topics of the page below the selection: each asks one question and knows none of the others."""
