//! Scene → Frame.
