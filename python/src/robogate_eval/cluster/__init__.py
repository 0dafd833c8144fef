"""Campaigns in shards on a cluster. Each module here works without Ray, except `tasks`."""
