"""Other people's tools beside this project on the same problems: a file a tool, each set up as its manual recommends.

    .venv/bin/python -m benchmarks.peers [--cycles N] [--seeds N] [--out FILE.md]

A peer is a solver in this project's own controller: prediction, guess and the step along the exact flow are the same
for all, so that what differs is the tool. The extra ``bench`` installs them; nothing in the package imports them.
"""

import benchmarks as benchmarks  # one BLAS thread, said before numpy is imported
