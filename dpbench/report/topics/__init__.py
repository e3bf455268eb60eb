"""Topics of the page below the selection: each answers one question, independent of the others."""
