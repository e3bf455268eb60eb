"""The report: reads the records of a result folder and turns them into words, tables, figures."""
