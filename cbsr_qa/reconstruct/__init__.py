"""What reconstructions share: the linearised problem, priors, choice of λ, noise propagation."""
