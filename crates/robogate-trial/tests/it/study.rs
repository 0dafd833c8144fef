//! Requests and states.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use robogate_core::Word;
use robogate_dictionary::hex;
use robogate_trial::{
    Command, Fault, Folder, HEAD, JOURNAL, Moment, Outcome, Phase, Problem, Question, Secret, Service, Study, Switch,
    SwitchSettings, Verdict, VoidBy, answer, csv_of, order, provenance, report,
};
use sha2::{Digest, Sha256};

use crate::{plan, result, study_of_two, trial};

#[test]
fn clear_winner_ends_the_study() {
    let (dir, mut folder) = study_of_two(52);
    let secret = Secret::read(&dir.path().join("secret.json")).unwrap();
    let order = order(&folder.study().plan, &secret).unwrap();
    let mut trials = 0;
    while folder.study().phase() != Phase::Finished {
        let arm = folder.study().current().unwrap().arm;
        assert_eq!(arm, order[trials].arm);
        trial(&mut folder, arm == 1);
        trials += 1;
    }
    assert_eq!(folder.study().decision().answer, Verdict::Best(1));
    assert!((8..40).contains(&trials), "{trials}");
    assert!(matches!(folder.unblind(false), Ok(())));
    let study = Folder::read(dir.path()).unwrap();
    let answer = answer(&study);
    assert_eq!((answer.verdict, answer.best.as_deref()), ("best", Some("beta-policy")));
    assert_eq!(answer.trials, trials as u64);
    let csv = csv_of(&study, None);
    assert_eq!(csv.lines().count(), trials + 1);
    assert!(
        csv.starts_with(
            "success,failure_mode,cycle_time_s,policy,case,operator,day,index,id,stage,notes,peak_force_n,setup\n"
        ),
        "{csv}"
    );
    let losers = csv_of(&study, Some(0));
    assert!(losers.lines().skip(1).all(|line| line.starts_with("false,dropped,") && line.contains("alpha-policy")));
    let page = report(&study, &answer);
    assert!(page.contains("beta-policy is better than alpha-policy."));
    // The policy of the page names its style by its hash, and allows no script.
    let between = |from: &str, to: &str| page.split(from).nth(1).unwrap().split(to).next().unwrap();
    let policy = between("<meta http-equiv=\"Content-Security-Policy\" content=\"", "\">");
    assert!(policy.starts_with("default-src 'none'; style-src 'sha256-") && !policy.contains("unsafe"), "{policy}");
    let named = decoded(between("'sha256-", "'"));
    assert_eq!(hex(&named), hex(&Sha256::digest(between("<style>", "</style>"))));
    assert!(provenance(dir.path(), &study, &answer, &csv).unwrap().contains(&study.plan.sha256()));
}

/// The bytes of a text in base64 (RFC 4648).
fn decoded(text: &str) -> Vec<u8> {
    const DIGITS: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bytes, mut bits, mut held) = (Vec::new(), 0_u32, 0);
    for digit in text.trim_end_matches('=').chars() {
        bits = (bits << 6) | DIGITS.find(digit).unwrap() as u32;
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    bytes
}

#[test]
fn early_unblinding_withdraws_the_claim() {
    let (dir, mut folder) = study_of_two(52);
    (0..9).for_each(|_| trial(&mut folder, true));
    assert!(matches!(folder.unblind(false), Err(Problem::Refused(_))));
    folder.unblind(true).unwrap();
    assert_eq!(folder.study().phase(), Phase::Finished);
    let code = folder.study().code().to_owned();
    assert!(folder.command("", &Command::Start { code, operator: "Ada".to_owned() }).is_err());
    drop(folder);
    assert_eq!(answer(&Folder::read(dir.path()).unwrap()).verdict, "withdrawn");
}

#[test]
fn codes_are_new_and_order_is_balanced() {
    let secret = Secret::draw().unwrap();
    let plan = plan(Question::Best, &["a", "b", "c"], 90, &secret);
    let order = order(&plan, &secret).unwrap();
    assert_eq!(order.len(), 270);
    for block in order.chunks(3) {
        let mut arms: Vec<usize> = block.iter().map(|planned| planned.arm).collect();
        arms.sort_unstable();
        assert_eq!(arms, [0, 1, 2]);
        assert!(block.iter().all(|planned| planned.setup == block[0].setup));
    }
    let first = order.chunks(3).filter(|block| block[0].arm == 0).count();
    assert!((12..50).contains(&first), "{first} of 90");
    let codes: std::collections::BTreeSet<String> = robogate_trial::Codes::new(&secret).take(2_000).collect();
    assert_eq!(codes.len(), 2_000);
    assert!(Study::new(plan, &Secret::draw().unwrap()).is_err(), "another secret");
}

#[test]
fn contradictions_are_refused() {
    let (_dir, mut folder) = study_of_two(10);
    let code = folder.study().code().to_owned();
    let start = Command::Start { code: code.clone(), operator: "Ada".to_owned() };
    assert!(folder.command("", &Command::Stop { code: code.clone() }).is_err(), "not started");
    assert!(folder.command("", &Command::Start { code: code.clone(), operator: " ".to_owned() }).is_err());
    folder.command("", &start).unwrap();
    let early = Command::Result { code: code.clone(), result: result(true) };
    assert!(folder.command("", &early).unwrap_err().to_string().contains("Press Stop first"));
    folder.command("", &Command::Stop { code: code.clone() }).unwrap();
    let word = |text| Some(Word::new(text).unwrap());
    for (wrong, part) in [
        (Outcome { success: true, mode: word("dropped"), ..Outcome::default() }, "a success cannot have"),
        (Outcome { success: true, stage: word("reach"), ..Outcome::default() }, "a success has reached every stage"),
        (Outcome::default(), "a failure needs a failure mode: dropped, missed"),
        (Outcome { mode: word("fell"), ..Outcome::default() }, "`fell` is not a failure mode"),
        (Outcome { mode: word("dropped"), stage: word("lift"), ..Outcome::default() }, "`lift` is not a stage"),
        (Outcome { mode: word("dropped"), measured: Some(f64::NAN), ..Outcome::default() }, "not finite"),
    ] {
        let error = folder.command("", &Command::Result { code: code.clone(), result: wrong }).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    folder.command("", &Command::Result { code: code.clone(), result: result(true) }).unwrap();
    let corrected = Command::Correct { code, result: result(false), reason: "wrong button".to_owned() };
    folder.command("", &corrected).unwrap();
    assert_eq!(folder.study().attempts()[0].success(), Some(false));
    assert_eq!(folder.study().attempts()[0].corrections, 1);
}

/// Before Stop a trial is repeated with another code; after it, invalid is the worst result.
#[test]
fn invalid_trials_are_repeated_or_fail() {
    let (_dir, mut folder) = study_of_two(10);
    let invalid = |code: &str| Command::Void { code: code.to_owned(), reason: "bumped table".to_owned() };
    let first = folder.study().code().to_owned();
    let arm = folder.study().current().unwrap().arm;
    let start = |code: &str| Command::Start { code: code.to_owned(), operator: "Ada".to_owned() };
    folder.command("", &start(&first)).unwrap();
    folder.command("", &invalid(&first)).unwrap();
    let second = folder.study().code().to_owned();
    assert_ne!(first, second);
    assert_eq!(folder.study().current().unwrap().arm, arm);
    folder.command("", &start(&second)).unwrap();
    folder.command("", &Command::Stop { code: second.clone() }).unwrap();
    folder.command("", &invalid(&second)).unwrap();
    let attempts = folder.study().attempts();
    assert!(matches!(attempts[0].void, Some((_, VoidBy::OperatorBefore))) && attempts[0].success().is_none());
    assert!(matches!(attempts[1].void, Some((_, VoidBy::OperatorAfter))));
    assert_eq!(attempts[1].success(), Some(false));
    assert_ne!(folder.study().current().unwrap().arm, arm, "the block goes on");
    trial(&mut folder, true);
    let block = &folder.study().blocks()[0];
    assert_eq!((block.success[arm], block.repeated[arm]), (Some(false), 1));
}

/// A changed clock does not reach durations, and after a restart of the machine they are unknown.
#[test]
fn durations_ignore_the_clock() {
    let start = Moment { unix_ms: 1_000_000, uptime_ms: 5_000, boot: "a".to_owned() };
    for step in [-3_600_000, 0, 3_600_000_i64] {
        let unix_ms = start.unix_ms.saturating_add_signed(step);
        let end = Moment { unix_ms, uptime_ms: 12_500, boot: "a".to_owned() };
        assert_eq!(end.seconds_since(&start), Some(7.5));
    }
    let restarted = Moment { boot: "b".to_owned(), ..start.clone() };
    assert_eq!(restarted.seconds_since(&start), None);
    let (one, other) = (Moment::now(), Moment::now());
    assert!(other.seconds_since(&one).unwrap() < 60.0);
}

/// Two phones send a different result for each of 500 trials at the same time: one record each, and the loser is told.
#[test]
fn two_phones_make_one_record() {
    let (dir, folder) = study_of_two(250);
    let service = Arc::new(Service::new(folder, None, "t".repeat(32), "s".repeat(32)));
    let send =
        |service: &Service, id: &str, rest: &str| service.execute(format!("{{\"id\":\"{id}\",{rest}}}").as_bytes());
    let mut told = 0;
    for n in 0..500 {
        let state: serde_json::Value = serde_json::from_str(&service.state()).unwrap();
        let code = state["code"].as_str().unwrap().to_owned();
        if state["phase"] == "finished" {
            panic!("ended after {n} trials");
        }
        send(&service, &format!("a{n}"), &format!("\"do\":\"start\",\"code\":\"{code}\",\"operator\":\"Ada\""))
            .unwrap();
        send(&service, &format!("o{n}"), &format!("\"do\":\"stop\",\"code\":\"{code}\"")).unwrap();
        let taps = std::thread::scope(|scope| {
            let tap = |phone: usize| {
                let (service, code) = (&service, &code);
                // Blocks have no winner, so the study goes on.
                let good = (n / 2 % 2 == 0) == (phone == 0);
                let result = if good { "{\"success\":true}" } else { "{\"success\":false,\"mode\":\"missed\"}" };
                let rest = format!("\"do\":\"result\",\"code\":\"{code}\",\"result\":{result}");
                scope.spawn(move || send(service, &format!("p{phone}-{n}"), &rest))
            };
            [tap(0), tap(1)].map(|thread| thread.join().unwrap())
        });
        assert_eq!(taps.iter().filter(|tap| matches!(tap, Ok(true))).count(), 1, "{taps:?}");
        told += taps
            .iter()
            .filter(|tap| matches!(tap, Err(Problem::Conflict(text)) if text.contains("not recorded")))
            .count();
        if serde_json::from_str::<serde_json::Value>(&service.state()).unwrap()["phase"] == "finished" {
            told += 499 - n;
            break;
        }
    }
    assert_eq!(told, 500);
    let study = Folder::read(dir.path()).unwrap();
    let codes: std::collections::BTreeSet<&str> = study.attempts().iter().map(|attempt| &*attempt.code).collect();
    assert_eq!(codes.len(), study.attempts().len());
}

#[test]
fn repeated_requests_have_one_record() {
    let (dir, mut folder) = study_of_two(10);
    let code = folder.study().code().to_owned();
    let start = Command::Start { code: code.clone(), operator: "Ada".to_owned() };
    assert!(folder.command("one", &start).unwrap());
    assert!(!folder.command("one", &start).unwrap());
    let other = Command::Stop { code: code.clone() };
    assert!(matches!(folder.command("one", &other), Err(Problem::Conflict(_))));
    assert!(matches!(folder.command("two", &start), Err(Problem::Conflict(_))), "another device");
    drop(folder);
    let mut folder = Folder::open(dir.path()).unwrap();
    assert!(!folder.command("one", &start).unwrap(), "also after a restart");
    assert_eq!(std::fs::read_to_string(dir.path().join(JOURNAL)).unwrap().lines().count(), 2);
}

#[test]
fn changed_plans_are_found() {
    let (dir, mut folder) = study_of_two(10);
    trial(&mut folder, true);
    drop(folder);
    let path = dir.path().join("plan.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"error\": 0.05", "\"error\": 0.1")).unwrap();
    assert!(matches!(Folder::read(dir.path()), Err(Problem::Changed { .. })));
    std::fs::write(&path, text).unwrap();
    assert_eq!(Folder::read(dir.path()).unwrap().attempts().len(), 1);
}

/// Whoever removes lines at the end cannot write the head that fits: none of its codes is in the journal.
#[test]
fn lines_cut_from_the_end_are_found() {
    let (dir, mut folder) = study_of_two(10);
    (0..2).for_each(|_| trial(&mut folder, true));
    drop(folder);
    let (journal, head) = (dir.path().join(JOURNAL), dir.path().join(HEAD));
    let whole = std::fs::read_to_string(&journal).unwrap();
    let written = std::fs::read_to_string(&head).unwrap();
    let code_of_head = written.trim_end().split_once(' ').unwrap().1;
    let lines: Vec<&str> = whole.split_inclusive('\n').collect();
    assert_eq!(lines.len(), 7);
    for kept in 1..=lines.len() {
        std::fs::write(&journal, lines[..kept].concat()).unwrap();
        let code = lines[kept - 1].trim_end().trim_end_matches("\"}").rsplit('"').next().unwrap();
        assert_eq!(code.len(), 64);
        let codes = [format!("{kept} {code}\n"), format!("{kept} {code_of_head}\n"), format!("0 {code}\n")];
        let heads = codes.map(Some).into_iter().chain([None]);
        for forged in heads.filter(|forged| forged.as_ref() != Some(&written)) {
            match &forged {
                Some(text) => std::fs::write(&head, text).unwrap(),
                None => std::fs::remove_file(&head).unwrap(),
            }
            let found = Folder::read(dir.path());
            assert!(matches!(found, Err(Problem::Changed { .. })), "{kept} lines, head {forged:?}: {found:?}");
            std::fs::write(&head, &written).unwrap();
        }
    }
    assert_eq!(Folder::read(dir.path()).unwrap().attempts().len(), 2);
}

/// Names with spaces around them, without letters, or that occur twice would stop the study at its first Start.
#[test]
fn operators_have_names_of_their_own() {
    let secret = Secret::draw().unwrap();
    let mut plan = plan(Question::AtLeast(0.5), &["a"], 10, &secret);
    let mut check = |names: &[&str]| {
        plan.operators = names.iter().map(|name| (*name).to_owned()).collect();
        plan.check().map_err(|problem| problem.to_string())
    };
    check(&["Ada", "Grace H."]).unwrap();
    let long = "a".repeat(101);
    for wrong in [" Ada", "Ada ", "", " ", &long] {
        assert!(check(&["Grace", wrong]).unwrap_err().contains("cannot name an operator"), "`{wrong}`");
    }
    assert!(check(&["Ada", "Grace", "Ada"]).unwrap_err().contains("`Ada` occurs twice among the operators"));
}

/// A trial that runs while the server is started again reaches its policy no more if a switch connects them: it is repeated.
#[test]
fn new_switches_repeat_the_running_trial() {
    let (dir, mut folder) = study_of_two(10);
    let code = folder.study().code().to_owned();
    folder.command("", &Command::Start { code: code.clone(), operator: "Ada".to_owned() }).unwrap();
    drop(folder);
    let service = |switch: Option<Switch>| {
        Service::new(Folder::open(dir.path()).unwrap(), switch, "t".repeat(32), "s".repeat(32))
    };
    assert_eq!(service(None).interrupted().unwrap(), None, "without a switch the trial goes on");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let servers = vec![listener.local_addr().unwrap(); 2];
    let any = SocketAddr::from(([127, 0, 0, 1], 0));
    let switch = || Switch::start(any, servers.clone(), SwitchSettings::default(), |_| {}).unwrap();
    let served = service(Some(switch()));
    assert_eq!(served.interrupted().unwrap(), Some(code));
    let state: serde_json::Value = serde_json::from_str(&served.state()).unwrap();
    assert_eq!(state["phase"], "ready");
    assert!(state["repeated"].as_str().unwrap().contains("started again"), "the page says so: {state}");
    drop(served);
    assert_eq!(service(Some(switch())).interrupted().unwrap(), None, "once");
    let study = Folder::read(dir.path()).unwrap();
    assert!(matches!(study.attempts(), [one] if matches!(one.void, Some((_, VoidBy::Infrastructure)))));
    assert_eq!(study.current().unwrap().arm, study.planned(&study.attempts()[0]).arm);
}

/// A trial whose server failed is repeated, and a fault that arrives late ends no other trial.
#[test]
fn server_faults_end_their_trial() {
    let (dir, folder) = study_of_two(10);
    let service = Service::new(folder, None, "t".repeat(32), "s".repeat(32));
    let state = || serde_json::from_str::<serde_json::Value>(&service.state()).unwrap();
    let start = |id: &str| {
        let code = state()["code"].as_str().unwrap().to_owned();
        let body = format!("{{\"id\":\"{id}\",\"do\":\"start\",\"code\":\"{code}\",\"operator\":\"Ada\"}}");
        assert!(service.execute(body.as_bytes()).unwrap());
        code
    };
    let fault =
        |code: &str| Fault { code: code.to_owned(), reason: "the policy server did not reply in time".to_owned() };
    let first = start("a");
    service.fault(&fault(&first)).unwrap();
    assert_eq!((&state()["phase"], &state()["repeated"]), (&"ready".into(), &fault("").reason.into()));
    let second = start("b");
    service.fault(&fault(&first)).unwrap();
    assert_eq!((&state()["phase"], &state()["code"]), (&"running".into(), &second.into()));
    let study = Folder::read(dir.path()).unwrap();
    assert!(matches!(study.attempts()[0].void, Some((_, VoidBy::Infrastructure))));
    assert_eq!(study.attempts()[0].planned, study.attempts()[1].planned);
}
