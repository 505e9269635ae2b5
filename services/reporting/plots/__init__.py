"""Plot descriptions of a run and the tables behind them, shared by the live page, the report and the figures."""
