"""The controllers a scenario may have, one class each."""
