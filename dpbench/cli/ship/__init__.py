"""Commands on a ship: written from its particulars, checked, its capability plot."""
