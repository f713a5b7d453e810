"""The paper's estimator: match and triangulate every slot by itself, then keep identities."""
