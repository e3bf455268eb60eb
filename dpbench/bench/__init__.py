"""The harness: closed loop, replay, clock, records, isolated workers, campaigns, the machine."""
