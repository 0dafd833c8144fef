//! Measures the overhead of a request to a policy server: two images of 256 x 256 pixels over the loopback interface,
//! to a server that answers immediately.
//!
//! `cargo bench -p robogate-policy [-- REQUESTS]`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints, and fails by panicking")]

use std::net::TcpListener;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use openpi::{actions, serve};
use robogate_policy::{ExternalPolicy, Profile};
use support::{begin, observation};
use tungstenite::Message;

#[path = "../tests/support/openpi.rs"]
mod openpi;

#[path = "../tests/support/mod.rs"]
mod support;

fn main() {
    let requests = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(500);
    let url = server();
    let built_in = Profile::built_in("pi0-libero").unwrap().replace("length = 50", "length = 10");
    let unchanged = built_in.replace("224", "256");
    for (what, text) in [("unchanged", unchanged), ("resized to 224 x 224", built_in)] {
        let mut policy = ExternalPolicy::connect(&url, Arc::new(Profile::from_toml(&text).unwrap())).unwrap();
        begin(&mut policy, "pick up the box").unwrap();
        let observation = observation(256);
        let mut times: Vec<f64> = (0..requests)
            .map(|_| {
                let start = Instant::now();
                policy.infer(&observation).unwrap();
                1e3 * start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let percentile = |q: usize| times[(times.len() - 1) * q / 100];
        let executed = 5.0;
        println!(
            "openpi, two images {what}: {:.3} ms per request (median), {:.3} ms (90th percentile), {:.3} ms per step if {executed} are executed",
            percentile(50),
            percentile(90),
            percentile(50) / executed
        );
    }
}

/// A server that answers each request with ten actions.
fn server() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    let answer = actions(10, 7, |_, _| 0.0);
    serve(listener, move |_, socket| {
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                socket.send(Message::binary(answer.clone())).unwrap();
            }
        }
        ControlFlow::Continue(())
    });
    url
}
