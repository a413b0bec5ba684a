//! Recordings: files ⇄ frames, star lists and telemetry, in the four forms that real cameras leave behind.
