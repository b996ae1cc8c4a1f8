"""How errors of rounding grow over long runs, and what single precision costs where it is used."""
