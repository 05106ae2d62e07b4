"""Updated sampling by a certificate carried online: the observer integrates a Riccati inequality beside its estimate.

    Pi' = -Pi A - A'Pi - Pi B(c) Pi - Q(c) - 2 sigma r Pi   between samples
    K = (Pi + C'Lambda C)^-1 C'Lambda,  Pi+ = Pi + C'Lambda C   at samples

`law` says the Riccati law once, in any arithmetic; `observer` runs it, `proof` proves its floor, `search` finds it.
"""
