"""Groups of values with a certified analysis of variance."""


def certified_table(offset, replicates):
    """SmLs01 to 09 (Simon & Lesage 1989): nine groups about 0.3 to 0.5, values 0.1 away; certified F = replicates."""
    return [
        [offset + tenths / 10] + [offset + (tenths + away) / 10 for away in (-1, 1)] * (replicates // 2)
        for tenths in (4, 3, 5, 3, 5, 3, 5, 3, 5)
    ]
