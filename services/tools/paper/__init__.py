"""The paper's figures and tables from runs of this project: ``python -P -m services.tools.paper``."""
