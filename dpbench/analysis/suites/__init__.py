"""What the suites of one topic ask beyond a verdict: claims, losses, slow-downs, studies."""
