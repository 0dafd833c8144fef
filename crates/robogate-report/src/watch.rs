//! Episodes worth watching: the list on a page, with the recordings for its viewer.

use robogate_replay::Reel;

/// Episodes worth watching, with their recordings.
#[derive(Debug, Clone, Default)]
pub struct Watch {
    /// The episodes, the most informative first.
    pub items: Vec<WatchItem>,
    /// The recordings. Empty if no episode could be recorded.
    pub reel: Option<Reel>,
    /// Sentences on what is not shown, and why.
    pub remarks: Vec<String>,
}

/// One entry of the list.
#[derive(Debug, Clone)]
pub struct WatchItem {
    /// The reason as a heading.
    pub title: String,
    /// The reason as a sentence.
    pub why: String,
    /// The outcome of the episode.
    pub outcome: String,
    /// Whether the episode succeeded.
    pub success: bool,
    /// The command that replays the episode.
    pub command: String,
    /// The comparison with the second episode, as a sentence. Empty without one.
    pub beside: String,
    /// Index of the recording in the reel. `None` if the episode is not recorded.
    pub clip: Option<usize>,
    /// Index of the recording of the second episode.
    pub second: Option<usize>,
    /// Frames of the episode and of the second one, for pages that cannot play them.
    pub strips: Vec<Strip>,
}

/// An image with frames of an episode, in a file beside the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Strip {
    /// The path of the file, relative to the page, with `/` between its parts.
    pub file: String,
    /// The content for readers who do not see it.
    pub alt: String,
}

impl Watch {
    /// Whether a viewer can show any episode.
    pub(crate) fn is_recorded(&self) -> bool {
        self.reel.is_some() && self.items.iter().any(|item| item.clip.is_some())
    }
}
