"""Controllers to take away: the complete control step of a scenario as C99, and as an FMU."""
