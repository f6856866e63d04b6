"""How numbers are shown by the report and the studies: tables, their files, means over seeds."""
