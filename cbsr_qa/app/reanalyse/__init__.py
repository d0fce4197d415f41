"""A changed analysis over many stored runs: values, verdicts that flip, and their adoption."""
