"""A Hokuyo scanner that is none: what the tests need of one."""
