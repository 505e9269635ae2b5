"""Other people's tools beside this project on the same problems: a file a tool, each set up as its manual recommends.

    .venv/bin/python -m benchmarks.peers [--cycles N] [--seeds N]

A peer is a solver in this project's own controller: prediction, guess and the step along the exact flow are the same
for all, so that what differs is the tool, and all are in the time. Times are of the same problems, those of a loop
that the first line drives, solved by all in an order drawn anew in each cycle. Errors are of closed loops that each
tool drives itself, with the state known. QP: the controller's own convex problem; NLP: the nonlinear problem behind it,
to its own local optimum. The extra ``bench`` installs them; nothing in the package imports them.
"""

import benchmarks as benchmarks  # one BLAS thread, said before numpy is imported
