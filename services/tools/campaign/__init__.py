"""Designs of many runs: which points, all cores or a cluster, results that can be reproduced to the byte."""
