"""Measurements of the whole, by hand: nothing imports them."""

import services as services  # one BLAS thread, said before numpy is imported
