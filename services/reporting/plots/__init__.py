"""What is drawn of a run: each plot described once, and the numbers behind them, for page, report and figure alike."""
