"""Many recordings: what is to be done, engines that do it, files that keep what came of it.

An engine (``local``, ``cluster``) turns recordings into records; a result file (``jsonl``,
``parquet``) keeps records and tells which recordings a second run can leave out.
"""
