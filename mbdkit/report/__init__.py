"""Reports: a run or a study as one self-contained HTML page, with its verdict, figures and tables."""
