"""Results of suites of one topic beyond a verdict: claims, losses, slow-downs, studies."""
