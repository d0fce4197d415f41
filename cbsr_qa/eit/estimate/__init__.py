"""Maximum-likelihood estimate of place and strength of a load, with the Cramér–Rao bound."""
