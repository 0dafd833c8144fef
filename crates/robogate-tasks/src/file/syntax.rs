//! The language of conditions, values and skills: words, numbers with units, calls and operators.
//!
//! From the loosest to the tightest: `or`; `and`; `not`; `A for T`, `A before B`, `A within T of B`; `<`, `>`; `+`, `-`;
//! `*`, `/`.

use super::units::{self, Quantity};

/// Longest text, in bytes.
const LONGEST: usize = 2000;
/// Deepest nesting.
const DEEPEST: usize = 32;

/// An expression, and where it begins in its text.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Node {
    pub(super) what: What,
    pub(super) at: usize,
}

/// An expression.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum What {
    Number(Quantity),
    /// The value of a parameter: `{opening_m}`.
    Parameter(String),
    /// A name, with dots.
    Name(String),
    Call(String, Vec<Node>),
    Negative(Box<Node>),
    /// `+`, `-`, `*`, `/`, `<`, `>`, and, or, before
    Binary(Operator, Box<Node>, Box<Node>),
    Not(Box<Node>),
    /// The condition and the duration.
    For(Box<Node>, Box<Node>),
    /// The condition, the duration, and the other condition.
    Within(Box<Node>, Box<Node>, Box<Node>),
}

/// An operator between two expressions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Operator {
    Or,
    And,
    Before,
    Less,
    Greater,
    Plus,
    Minus,
    Times,
    Over,
}

/// What is wrong with a text, and where.
pub(super) type Wrong = (usize, String);

#[derive(Debug, Clone, PartialEq)]
enum Token {
    Number(Quantity),
    Word(String),
    Parameter(String),
    Mark(char),
    End,
}

/// Reads an expression.
///
/// # Errors
/// The first problem.
pub(super) fn parse(text: &str) -> Result<Node, Wrong> {
    if text.len() > LONGEST {
        return Err((0, format!("the text has {} bytes. At most {LONGEST} are accepted", text.len())));
    }
    if text.starts_with(super::import::UNFINISHED) {
        let example = "such as `joint(drawer) > 15 cm` or `on(cup, shelf) for 0.5 s`";
        return Err((0, format!("the condition is not written yet. Say when it holds, {example}")));
    }
    let mut parser = Parser { tokens: tokens(text)?, next: 0, depth: 0 };
    let node = parser.any()?;
    match parser.peek() {
        (Token::End, _) => Ok(node),
        (token, at) => Err((*at, format!("unexpected {} after the expression", shown(token)))),
    }
}

fn shown(token: &Token) -> String {
    match token {
        Token::Number(quantity) => format!("number {}", quantity.value),
        Token::Word(word) => format!("word `{word}`"),
        Token::Parameter(name) => format!("`{{{name}}}`"),
        Token::Mark(mark) => format!("`{mark}`"),
        Token::End => "end".to_owned(),
    }
}

fn tokens(text: &str) -> Result<Vec<(Token, usize)>, Wrong> {
    let bytes = text.as_bytes();
    let run = |from: usize, accepts: &dyn Fn(u8) -> bool| {
        bytes[from..].iter().position(|byte| !accepts(*byte)).map_or(bytes.len(), |length| from + length)
    };
    let word = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'.';
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let start = at;
        match bytes[at] {
            byte if byte.is_ascii_whitespace() => at += 1,
            byte if byte.is_ascii_digit() => {
                at = run(at, &|byte| byte.is_ascii_digit() || byte == b'.');
                let number = text[start..at].to_owned();
                // A unit follows if the next word is one: `2 cm/s`.
                let next = run(at, &|byte| byte == b' ');
                let mut end = run(next, &|byte| byte.is_ascii_alphabetic() || byte == b'%');
                let is_unit = |text: &str| units::UNITS.iter().any(|(unit, ..)| *unit == text);
                if is_unit(&text[next..end]) {
                    if bytes.get(end) == Some(&b'/') {
                        let over = run(end + 1, &|byte| byte.is_ascii_alphabetic());
                        if is_unit(&text[end + 1..over]) {
                            let power = bytes[over..].starts_with(b"^2") || bytes[over..].starts_with(b"^3");
                            end = over + 2 * usize::from(power);
                        }
                    }
                    at = end;
                }
                let unit = text[number.len() + start..at].trim();
                let quantity = units::quantity(&format!("{number} {unit}")).map_err(|why| (start, why))?;
                found.push((Token::Number(quantity), start));
            }
            byte if byte.is_ascii_alphabetic() => {
                at = run(at, &word);
                found.push((Token::Word(text[start..at].to_owned()), start));
            }
            b'{' => {
                let end = run(at + 1, &word);
                if bytes.get(end) != Some(&b'}') {
                    return Err((start, "`{` without `}`. Expected the name of a parameter: `{opening_m}`".to_owned()));
                }
                found.push((Token::Parameter(text[at + 1..end].to_owned()), start));
                at = end + 1;
            }
            mark @ (b'(' | b')' | b',' | b'<' | b'>' | b'+' | b'-' | b'*' | b'/') => {
                found.push((Token::Mark(mark.into()), start));
                at += 1;
                // `<=` and `<` are the same for measured numbers.
                if matches!(mark, b'<' | b'>') && bytes.get(at) == Some(&b'=') {
                    at += 1;
                }
            }
            _ => {
                let mark = text[at..].chars().next().unwrap_or(' ');
                return Err((at, format!("unexpected `{mark}`")));
            }
        }
    }
    found.push((Token::End, bytes.len()));
    Ok(found)
}

struct Parser {
    tokens: Vec<(Token, usize)>,
    next: usize,
    depth: usize,
}

type Parsed = Result<Node, Wrong>;

impl Parser {
    fn peek(&self) -> &(Token, usize) {
        &self.tokens[self.next.min(self.tokens.len() - 1)]
    }

    fn take(&mut self) -> (Token, usize) {
        let token = self.peek().clone();
        self.next += 1;
        token
    }

    fn takes(&mut self, wanted: &Token) -> bool {
        let found = self.peek().0 == *wanted;
        self.next += usize::from(found);
        found
    }

    fn takes_word(&mut self, word: &str) -> bool {
        self.takes(&Token::Word(word.to_owned()))
    }

    /// Operands of one kind of operator, from left to right.
    fn chain(&mut self, operators: &[(Token, Operator)], operand: fn(&mut Self) -> Parsed) -> Parsed {
        let mut left = operand(self)?;
        while let Some((_, operator)) = operators.iter().find(|(token, _)| self.peek().0 == *token) {
            self.next += 1;
            let right = operand(self)?;
            let at = left.at;
            left = Node { what: What::Binary(*operator, Box::new(left), Box::new(right)), at };
        }
        Ok(left)
    }

    fn any(&mut self) -> Parsed {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err((self.peek().1, format!("nested too deeply. At most {DEEPEST} levels are accepted")));
        }
        let node = self.chain(&[(Token::Word("or".to_owned()), Operator::Or)], Self::all);
        self.depth -= 1;
        node
    }

    fn all(&mut self) -> Parsed {
        self.chain(&[(Token::Word("and".to_owned()), Operator::And)], Self::negation)
    }

    fn negation(&mut self) -> Parsed {
        let at = self.peek().1;
        if !self.takes_word("not") {
            return self.timed();
        }
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err((at, format!("nested too deeply. At most {DEEPEST} levels are accepted")));
        }
        let inner = self.negation()?;
        self.depth -= 1;
        Ok(Node { what: What::Not(Box::new(inner)), at })
    }

    fn timed(&mut self) -> Parsed {
        let condition = self.comparison()?;
        let at = condition.at;
        let what = if self.takes_word("for") {
            What::For(Box::new(condition), Box::new(self.sum()?))
        } else if self.takes_word("before") {
            What::Binary(Operator::Before, Box::new(condition), Box::new(self.comparison()?))
        } else if self.takes_word("within") {
            let duration = self.sum()?;
            if !self.takes_word("of") {
                let (token, at) = self.peek();
                return Err((*at, format!("found {}. Expected `A within 2 s of B`", shown(token))));
            }
            What::Within(Box::new(condition), Box::new(duration), Box::new(self.comparison()?))
        } else {
            return Ok(condition);
        };
        Ok(Node { what, at })
    }

    fn comparison(&mut self) -> Parsed {
        let marks = [(Token::Mark('<'), Operator::Less), (Token::Mark('>'), Operator::Greater)];
        self.chain(&marks, Self::sum)
    }

    fn sum(&mut self) -> Parsed {
        let marks = [(Token::Mark('+'), Operator::Plus), (Token::Mark('-'), Operator::Minus)];
        self.chain(&marks, Self::product)
    }

    fn product(&mut self) -> Parsed {
        let marks = [(Token::Mark('*'), Operator::Times), (Token::Mark('/'), Operator::Over)];
        self.chain(&marks, Self::atom)
    }

    fn atom(&mut self) -> Parsed {
        let (token, at) = self.take();
        let what = match token {
            Token::Number(quantity) => What::Number(quantity),
            Token::Parameter(name) => What::Parameter(name),
            Token::Mark('-') => match self.take() {
                (Token::Number(quantity), _) => What::Number(Quantity { value: -quantity.value, ..quantity }),
                (Token::Parameter(name), at) => What::Negative(Box::new(Node { what: What::Parameter(name), at })),
                (token, at) => return Err((at, format!("found {} after `-`. Expected a number", shown(&token)))),
            },
            Token::Mark('(') => {
                let inner = self.any()?;
                self.close()?;
                return Ok(inner);
            }
            Token::Word(name) if self.takes(&Token::Mark('(')) => {
                let mut arguments = Vec::new();
                if !self.takes(&Token::Mark(')')) {
                    loop {
                        arguments.push(self.any()?);
                        if !self.takes(&Token::Mark(',')) {
                            break;
                        }
                    }
                    self.close()?;
                }
                What::Call(name, arguments)
            }
            Token::Word(name) => What::Name(name),
            token => return Err((at, format!("found {}. Expected a condition, a value or a number", shown(&token)))),
        };
        Ok(Node { what, at })
    }

    fn close(&mut self) -> Result<(), Wrong> {
        match self.take() {
            (Token::Mark(')'), _) => Ok(()),
            (token, at) => Err((at, format!("found {}. Expected `)` or `,`", shown(&token)))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expression with all brackets.
    fn bracketed(node: &Node) -> String {
        match &node.what {
            What::Number(quantity) => format!("{}{}", quantity.value, quantity.dimension.unit()),
            What::Parameter(name) => format!("{{{name}}}"),
            What::Name(name) => name.clone(),
            What::Call(name, of) => format!("{name}[{}]", of.iter().map(bracketed).collect::<Vec<_>>().join(";")),
            What::Negative(of) => format!("-{}", bracketed(of)),
            What::Binary(operator, one, two) => format!("({} {operator:?} {})", bracketed(one), bracketed(two)),
            What::Not(of) => format!("!{}", bracketed(of)),
            What::For(of, time) => format!("({} for {})", bracketed(of), bracketed(time)),
            What::Within(of, time, other) => {
                format!("({} within {} of {})", bracketed(of), bracketed(time), bracketed(other))
            }
        }
    }

    #[test]
    fn operators_bind_as_documented() {
        for (text, expected) in [
            ("a or b and not c", "(a Or (b And !c))"),
            (
                "joint(d.x) > 15 cm for 0.5 s and speed(d) < 2 cm/s",
                "(((joint[d.x] Greater 0.15m) for 0.5s) And (speed[d] Less 0.02m/s))",
            ),
            ("x > {o} - 1 cm * 2", "(x Greater ({o} Minus (0.01m Times 2)))"),
            ("a(-3 deg, b) before c within 2 s of d", ""),
            ("(a or b) for 1 s", "((a Or b) for 1s)"),
            ("a within 2 s of b", "(a within 2s of b)"),
            ("a <= 3", "(a Less 3)"),
        ] {
            match parse(text) {
                Ok(node) => assert_eq!(bracketed(&node), expected, "{text}"),
                Err(_) => assert!(expected.is_empty(), "{text}"),
            }
        }
    }

    #[test]
    fn wrong_text_is_located() {
        for (text, at) in
            [("a and", 5), ("f(a", 3), ("a b", 2), ("a & b", 2), ("{a", 0), ("3 < ", 4), ("a within 2 s", 12)]
        {
            assert_eq!(parse(text).unwrap_err().0, at, "{text}");
        }
        assert!(parse(&"(".repeat(100)).unwrap_err().1.contains("too deeply"));
        assert!(parse(&"not ".repeat(100)).unwrap_err().1.contains("too deeply"));
        assert!(parse(&"a ".repeat(5000)).unwrap_err().1.contains("bytes"));
    }
}
