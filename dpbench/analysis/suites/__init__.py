"""Results of suites of one topic beyond a verdict: claims, losses, slowdowns, studies."""
