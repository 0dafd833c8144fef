//! Reads LIBERO's task files (BDDL).

/// Largest text, in bytes, and deepest nesting.
const MOST_BYTES: usize = 256 << 10;
const DEEPEST: usize = 16;

/// An expression: a word, or a list in parentheses.
#[derive(Debug, Clone)]
enum Expression {
    Word(String),
    List(Vec<Self>),
}

/// A rectangle on the table or a named place of a body.
#[derive(Debug, Clone)]
pub(super) struct Region {
    /// Its name with that of its target: `main_table_plate_region`.
    pub(super) name: String,
    pub(super) target: String,
    /// Smallest x and y, largest x and y, in metres.
    pub(super) range: Option<[f64; 4]>,
    /// Smallest and largest rotation about the vertical, in radians.
    pub(super) yaw: [f64; 2],
}

/// A task file.
#[derive(Debug, Clone, Default)]
pub(super) struct Task {
    pub(super) problem: String,
    pub(super) instruction: String,
    pub(super) regions: Vec<Region>,
    /// Names with their categories.
    pub(super) fixtures: Vec<(String, String)>,
    pub(super) objects: Vec<(String, String)>,
    pub(super) start: Vec<Vec<String>>,
    pub(super) goal: Vec<Vec<String>>,
}

impl Expression {
    fn words(&self) -> Vec<String> {
        match self {
            Self::Word(word) => vec![word.clone()],
            Self::List(items) => items.iter().flat_map(Self::words).collect(),
        }
    }

    fn items(&self) -> &[Self] {
        match self {
            Self::Word(_) => &[],
            Self::List(items) => items,
        }
    }

    /// The first word of a list.
    fn head(&self) -> &str {
        match self.items().first() {
            Some(Self::Word(word)) => word,
            _ => "",
        }
    }
}

/// Reads a task file.
pub(super) fn parse(text: &str) -> Result<Task, String> {
    if text.len() > MOST_BYTES {
        return Err(format!("it has more than {} KiB", MOST_BYTES >> 10));
    }
    let whole = tree(text)?;
    if whole.head() != "define" {
        return Err("it does not start with (define".to_owned());
    }
    let mut task = Task::default();
    for section in &whole.items()[1..] {
        let rest = section.items().get(1..).unwrap_or_default();
        let words = || rest.iter().flat_map(Expression::words).collect::<Vec<_>>();
        match section.head() {
            "problem" => task.problem = words().join(" "),
            ":language" => task.instruction = words().join(" "),
            ":regions" => task.regions = rest.iter().map(region).collect::<Result<_, _>>()?,
            ":fixtures" => task.fixtures = typed(&words(), ":fixtures")?,
            ":objects" => task.objects = typed(&words(), ":objects")?,
            ":init" => task.start = rest.iter().map(predicate).collect::<Result<_, _>>()?,
            ":goal" => {
                let Some(goal) = rest.first() else { return Err("the goal is empty".to_owned()) };
                let parts = if goal.head().eq_ignore_ascii_case("and") {
                    &goal.items()[1..]
                } else {
                    std::slice::from_ref(goal)
                };
                task.goal = parts.iter().map(predicate).collect::<Result<_, _>>()?;
            }
            _ => {}
        }
    }
    if task.goal.is_empty() {
        return Err("it has no :goal".to_owned());
    }
    Ok(task)
}

/// A predicate in lower case with its arguments.
fn predicate(expression: &Expression) -> Result<Vec<String>, String> {
    let plain = |item: &Expression| matches!(item, Expression::Word(_));
    if expression.items().is_empty() || !expression.items().iter().all(plain) {
        let found = expression.words().join(" ");
        return Err(format!("`{found}` is not a predicate of names. Expected predicates joined by And"));
    }
    let mut words = expression.words();
    words[0] = words[0].to_lowercase();
    Ok(words)
}

/// `a b - kind c - other`: names with their kinds.
fn typed(words: &[String], section: &str) -> Result<Vec<(String, String)>, String> {
    let (mut found, mut names): (Vec<_>, Vec<&String>) = (Vec::new(), Vec::new());
    let mut words = words.iter();
    while let Some(word) = words.next() {
        if word != "-" {
            names.push(word);
            continue;
        }
        let Some(kind) = words.next() else { return Err(format!("{section}: the last names have no category")) };
        found.extend(names.drain(..).map(|name| (name.clone(), kind.clone())));
    }
    if names.is_empty() { Ok(found) } else { Err(format!("{section}: the last names have no category")) }
}

fn region(expression: &Expression) -> Result<Region, String> {
    let name = expression.head();
    let attribute = |wanted: &str| expression.items().iter().find(|item| item.head() == wanted);
    let target = attribute(":target").map(|of| of.words()).and_then(|words| words.get(1).cloned());
    let target = target.ok_or_else(|| format!("the region `{name}` has no :target"))?;
    let numbers = |wanted: &str| -> Result<Vec<f64>, String> {
        let words = attribute(wanted).map(Expression::words).unwrap_or_default();
        let number = |word: &String| word.parse::<f64>().ok().filter(|x| x.is_finite() && x.abs() < 100.0);
        let found: Option<Vec<f64>> = words.iter().skip(1).map(number).collect();
        found.ok_or_else(|| format!("the region `{name}`: {wanted} has a word that is not a number"))
    };
    let ranges = numbers(":ranges")?;
    let range = match ranges[..] {
        [] => None,
        [x, y, right, top, ..] if x <= right && y <= top => Some([x, y, right, top]),
        _ => return Err(format!("the region `{name}`: :ranges are not four numbers, the smaller two first")),
    };
    let yaw = match numbers(":yaw_rotation")?[..] {
        [low, high] => [low.min(high), low.max(high)],
        _ => [0.0; 2],
    };
    Ok(Region { name: format!("{target}_{name}"), target, range, yaw })
}

/// The first list of a text. A semicolon starts a comment.
fn tree(text: &str) -> Result<Expression, String> {
    let mut stack: Vec<Vec<Expression>> = Vec::new();
    for line in text.lines() {
        let code = line.split(';').next().unwrap_or_default().replace('(', " ( ").replace(')', " ) ");
        for word in code.split_whitespace() {
            match (word, stack.len()) {
                ("(", depth) if depth >= DEEPEST => {
                    return Err(format!("its parentheses are nested in more than {DEEPEST} levels"));
                }
                ("(", _) => stack.push(Vec::new()),
                (_, 0) => {
                    let shown: String = word.chars().take(40).collect();
                    return Err(format!("it starts with `{shown}`. Expected ("));
                }
                (")", _) => {
                    let done = Expression::List(stack.pop().unwrap_or_default());
                    match stack.last_mut() {
                        Some(outer) => outer.push(done),
                        None => return Ok(done),
                    }
                }
                (word, depth) => stack[depth - 1].push(Expression::Word(word.to_owned())),
            }
        }
    }
    Err("a parenthesis is not closed".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_files_are_explained() {
        for (text, expected) in [
            ("", "not closed"),
            ("goal", "starts with `goal`"),
            ("(problem x)", "does not start with (define"),
            ("(define (problem x))", "no :goal"),
            ("(define (:goal (And (On (a) b))))", "not a predicate"),
            ("(define (:objects a b))", "no category"),
            ("(define (:regions (r (:ranges ((0 0 1 1))))))", "no :target"),
            ("(define (:regions (r (:target t) (:ranges ((0 0 -1 1))))))", "four numbers"),
            ("(define (:regions (r (:target t) (:ranges ((0 0 x 1))))))", "not a number"),
        ] {
            let found = parse(text).unwrap_err();
            assert!(found.contains(expected), "{text}: {found}");
        }
        assert!(parse(&"(".repeat(100)).unwrap_err().contains("16 levels"));
    }
}
