"""HTML pages: reports of runs and studies, and animations; each page is self-contained and works offline."""
