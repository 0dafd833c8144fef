//! The server of the page.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use robogate_monitor::service::{HttpError, LocalReply, LocalRequest, random_token, serve_local};
use robogate_report::{explorer_page, script_data};
use serde_json::{Value, json};

use super::board::Board;
use super::model;
use super::player::{NoClip, Player};
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{line, note};
use robogate_session::Reopening;

/// Shortest time between two looks at the runs.
const LOOK: Duration = Duration::from_millis(400);
/// Largest number of rows of a reply.
const MOST_ROWS: usize = 100_000;

struct State {
    player: Player,
    looked: Mutex<Instant>,
    /// The last model of each run.
    models: Mutex<Vec<Option<Fitted>>>,
}

/// A model of a run.
#[derive(Clone)]
struct Fitted {
    epoch: u64,
    /// The number of rows that it was fitted to.
    rows: usize,
    json: Vec<u8>,
}

/// Serves the page until the process is interrupted.
pub(super) fn serve(address: SocketAddr, board: Board, opening: Reopening) -> Result<u8, Exit> {
    let token = random_token().or_broken()?;
    let names: Vec<&str> = board.runs.iter().map(|run| run.name.as_str()).collect();
    let (html, policy) = explorer_page(&names.join(", "), None);
    let runs = board.runs.len();
    let state = Arc::new(State {
        player: Player::new(board, opening),
        looked: Mutex::new(Instant::now()),
        models: Mutex::new(vec![None; runs]),
    });
    let (stop, stopped) = tokio::sync::oneshot::channel();
    let stop = Mutex::new(Some(stop));
    ctrlc::set_handler(move || {
        let stop = stop.lock().unwrap_or_else(PoisonError::into_inner).take();
        // The server may have ended already.
        let _ = stop.map(|stop| stop.send(()));
    })
    .or_broken()?;
    let page = LocalReply::Page { html, policy };
    let answer = move |request: &LocalRequest| match request.path.as_str() {
        "/" => page.clone(),
        _ => state.answer(request),
    };
    let listening = |address: SocketAddr| {
        line(format_args!("http://{address}/#token={token}"));
        note("Open this address in a browser on this machine. Ctrl-C ends the server.");
    };
    match serve_local(address, &token, Arc::new(answer), listening, stopped) {
        Ok(()) => Ok(DONE),
        error @ Err(HttpError::Listen { .. }) => error.or_broken().map(|()| DONE),
        error => error.or_usage().map(|()| DONE),
    }
}

impl State {
    fn answer(&self, request: &LocalRequest) -> LocalReply {
        let number = |name: &str| request.value(name).and_then(|text| text.parse::<u64>().ok());
        match request.path.as_str() {
            "/v1/state" => LocalReply::Json(self.state()),
            "/v1/rows" => match (number("epoch"), number("from"), number("to")) {
                (Some(epoch), Some(from), Some(to)) => self.rows(epoch, from, to),
                _ => LocalReply::Wrong("expected /v1/rows?epoch=N&from=N&to=N".to_owned()),
            },
            "/v1/model" => match number("run") {
                Some(run) => self.model(run),
                None => LocalReply::Wrong("expected /v1/model?run=N".to_owned()),
            },
            "/v1/clip" => match (number("run"), number("index")) {
                (Some(run), Some(index)) => self.clip(run, index),
                _ => LocalReply::Wrong("expected /v1/clip?run=N&index=N".to_owned()),
            },
            _ => LocalReply::NotFound("not found; the page is at /".to_owned()),
        }
    }

    fn state(&self) -> Vec<u8> {
        let mut looked = self.looked.lock().unwrap_or_else(PoisonError::into_inner);
        let state = self.player.with_board(|board| {
            if looked.elapsed() >= LOOK {
                board.look();
                *looked = Instant::now();
            }
            board.state()
        });
        bytes(&state)
    }

    fn rows(&self, epoch: u64, from: u64, to: u64) -> LocalReply {
        self.player.with_board(|board| {
            let rows = board.table.rows();
            let (from, to) = (usize::try_from(from).unwrap_or(usize::MAX), usize::try_from(to).unwrap_or(usize::MAX));
            if epoch != board.epoch {
                return LocalReply::Wrong(format!("epoch {epoch} is over; the present one is {}", board.epoch));
            }
            if from > to || to > rows || to - from > MOST_ROWS {
                return LocalReply::Wrong(format!(
                    "rows {from} to {to} are out of range: expected 0 to {rows}, and at most {MOST_ROWS} rows"
                ));
            }
            LocalReply::Bytes(board.table.bytes(from..to))
        })
    }

    fn model(&self, run: u64) -> LocalReply {
        let Ok(at) = usize::try_from(run) else { return no_run(run) };
        let copied = self.player.with_board(|board| {
            let of = board.runs.get(at)?;
            Some((board.epoch, board.table.rows(), of.is_finished(), model::training(&board.table, at, &of.provenance)))
        });
        let Some((epoch, rows, finished, training)) = copied else { return no_run(run) };
        let mut models = self.models.lock().unwrap_or_else(PoisonError::into_inner);
        // A fit takes seconds, so that of a running campaign is kept until a fifth of its rows is new.
        let fresh = |known: &&Fitted| {
            known.epoch == epoch && if finished { known.rows == rows } else { 5 * rows <= 6 * known.rows }
        };
        if let Some(known) = models.get(at).and_then(Option::as_ref).filter(fresh) {
            return LocalReply::Json(known.json.clone());
        }
        let json = bytes(&model::fit(&training).unwrap_or_else(|because| json!({ "version": 1, "because": because })));
        if let Some(place) = models.get_mut(at) {
            *place = Some(Fitted { epoch, rows, json: json.clone() });
        }
        LocalReply::Json(json)
    }

    fn clip(&self, run: u64, index: u64) -> LocalReply {
        let Ok(at) = usize::try_from(run) else { return no_run(run) };
        match self.player.clip(at, index) {
            Ok(document) => LocalReply::Json(document),
            Err(NoClip::NoRun) => no_run(run),
            Err(NoClip::NotPlayable) => LocalReply::Wrong(NoClip::NotPlayable.to_string()),
            Err(other @ NoClip::NoEpisode(_)) => LocalReply::NotFound(other.to_string()),
            Err(NoClip::Failed(because)) => LocalReply::Failed(because),
        }
    }
}

fn no_run(run: u64) -> LocalReply {
    LocalReply::NotFound(format!("there is no run {run}"))
}

fn bytes(document: &Value) -> Vec<u8> {
    script_data(&document.to_string()).into_bytes()
}
