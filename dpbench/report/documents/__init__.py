"""Documents for others: a comment, a statement, the report as Markdown, a folder to send."""
