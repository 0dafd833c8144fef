//! `robogate view`: explores the episodes of one or several runs in the browser.

mod board;
mod clips;
mod export;
mod model;
mod player;
mod server;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use clap::Args;

use crate::arguments::ReopeningArguments;
use crate::exit::Exit;
use board::Board;
pub(in crate::commands) use player::Player;

/// Largest number of rows of a served page. The server and the browser need 4 bytes for each value of a row.
const MOST_ROWS: usize = 1_000_000;
/// Default of the largest number of recorded episodes in an exported page.
const CLIPS: u16 = 12;
/// Largest number of rows of an exported page.
const MOST_ROWS_OF_EXPORT: usize = 250_000;

/// Explore the episodes of one or several runs: parallel coordinates, scatter plots, the model's map, and replays.
///
/// Without --out the page is served on this machine until Ctrl-C, and a run in progress updates. The printed address
/// contains a token, without which nobody reads the data.
#[derive(Debug, Args)]
pub(crate) struct View {
    /// Folders of runs (also unfinished ones, and campaigns in shards), dictionaries (Parquet) or published JSON
    /// dictionaries
    #[arg(required = true, value_name = "DIR")]
    runs: Vec<PathBuf>,
    /// Write one self-contained page to this file instead of serving
    #[arg(long = "out", alias = "export", value_name = "FILE")]
    export: Option<PathBuf>,
    /// Choose the largest number of recorded episodes in the exported page (0 to 200); default: 12
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=200), requires = "export")]
    clips: Option<u16>,
    /// Choose the largest number of rows of the page; of more, it has a random sample and says so. The rates without a
    /// selection always count all episodes. Default: 250,000 in an exported page, 1,000,000 in a served one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    rows: Option<u32>,
    /// Serve on this port of 127.0.0.1; 0 lets the system choose
    #[arg(long, value_name = "PORT", default_value_t = 0, conflicts_with = "export")]
    port: u16,
    #[command(flatten)]
    opening: ReopeningArguments,
}

impl View {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let rows = self.rows.map(|rows| rows as usize);
        let most = rows.unwrap_or(MOST_ROWS);
        let board = Board::open(&self.runs, if self.export.is_some() { most.max(MOST_ROWS) } else { most })?;
        match &self.export {
            Some(file) => {
                let rows = rows.unwrap_or(MOST_ROWS_OF_EXPORT);
                export::write(file, board, &self.opening.choice(), self.clips, rows)
            }
            None => {
                let address = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port));
                server::serve(address, board, self.opening.choice().clone())
            }
        }
    }
}
