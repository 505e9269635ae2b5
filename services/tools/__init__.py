"""Offline tools of the command line: campaigns, checks and measurements that never run beside a vehicle."""
