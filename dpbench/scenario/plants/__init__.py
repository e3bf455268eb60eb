"""Plants other than dpbench's own ship: the contract, a linear MPC for them, and FMUs."""
