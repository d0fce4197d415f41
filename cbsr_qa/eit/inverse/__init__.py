"""The linearised inverse problem and what reconstructions share: priors, one-step solutions, noise."""
