"""A solver's settings searched on some sequences of QPs and measured on others."""
