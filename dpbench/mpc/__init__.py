"""The model predictive controller: model, condensed QP, law, stability (paper section III)."""
