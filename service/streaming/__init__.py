"""Streams: a session as a state machine without I/O, and the pipeline that computes its results.

The audio's path: ``intake`` (whole sample frames) → ``buffer`` (bounded, oldest dropped) →
``pipeline`` (samples, resampling, STFT, localizer, tracker) → ``reporter`` (messages). All but the
pipeline is cheap and runs on the event loop. The pipeline runs in a worker process, one step at a
time; a thread beside it checks the channels (``diagnostics``).
"""
