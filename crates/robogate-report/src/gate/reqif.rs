//! Gate evaluations as ReqIF 1.2, the exchange format of requirement management tools.
//!
//! Each requirement becomes a spec object with its identifiers, limit, observed figure and status, so that a tool can
//! link the result to the requirement that it verifies. The dates are those of no clock: equal evaluations give equal
//! bytes, and the importing tool knows when it imported.

use std::fmt::Write;

use robogate_gate::Evaluation;
use robogate_stats::format::is_deceptive;

use super::RequirementRow;

/// The date of all objects.
const DATE: &str = "1970-01-01T00:00:00Z";

/// The attributes of a requirement: identifier and name.
const ATTRIBUTES: [(&str, &str); 8] = [
    ("external-id", "ReqIF.ForeignID"),
    ("name", "ReqIF.Name"),
    ("text", "ReqIF.Text"),
    ("observed", "Observed"),
    ("interval", "Confidence interval"),
    ("status", "Status"),
    ("verdict", "Verdict of the gate"),
    ("dataset", "SHA-256 of the episodes"),
];

/// The evaluation as a ReqIF document.
pub fn reqif(evaluation: &Evaluation) -> String {
    let digest = evaluation.dataset_sha256.get(..12).unwrap_or(&evaluation.dataset_sha256);
    let name = &evaluation.requirements.name;
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let mut put = |text: &str| {
        out.push_str(text);
        out.push('\n');
    };
    put("<REQ-IF xmlns=\"http://www.omg.org/spec/ReqIF/20110401/reqif.xsd\">");
    put("<THE-HEADER>");
    put(&format!("<REQ-IF-HEADER IDENTIFIER=\"robogate-{}\">", escape(digest)));
    put(&format!("<COMMENT>{}</COMMENT>", escape(&evaluation.because)));
    put(&format!("<CREATION-TIME>{DATE}</CREATION-TIME>"));
    put("<REQ-IF-TOOL-ID>robogate</REQ-IF-TOOL-ID>");
    put("<REQ-IF-VERSION>1.0</REQ-IF-VERSION>");
    put(&format!("<SOURCE-TOOL-ID>robogate {}</SOURCE-TOOL-ID>", env!("CARGO_PKG_VERSION")));
    put(&format!("<TITLE>{}</TITLE>", escape(&format!("Gate {name}: {}", evaluation.policy))));
    put("</REQ-IF-HEADER>\n</THE-HEADER>\n<CORE-CONTENT>\n<REQ-IF-CONTENT>\n<DATATYPES>");
    put(&format!(
        "<DATATYPE-DEFINITION-STRING IDENTIFIER=\"text\" LAST-CHANGE=\"{DATE}\" LONG-NAME=\"Text\" MAX-LENGTH=\"32000\"/>"
    ));
    put("</DATATYPES>\n<SPEC-TYPES>");
    put(&format!(
        "<SPEC-OBJECT-TYPE IDENTIFIER=\"requirement\" LAST-CHANGE=\"{DATE}\" LONG-NAME=\"Requirement\">\n<SPEC-ATTRIBUTES>"
    ));
    for (id, long) in ATTRIBUTES {
        put(&format!(
            "<ATTRIBUTE-DEFINITION-STRING IDENTIFIER=\"attribute-{id}\" LAST-CHANGE=\"{DATE}\" LONG-NAME=\"{long}\">\
             <TYPE><DATATYPE-DEFINITION-STRING-REF>text</DATATYPE-DEFINITION-STRING-REF></TYPE>\
             </ATTRIBUTE-DEFINITION-STRING>"
        ));
    }
    put("</SPEC-ATTRIBUTES>\n</SPEC-OBJECT-TYPE>");
    put(&format!("<SPECIFICATION-TYPE IDENTIFIER=\"gate\" LAST-CHANGE=\"{DATE}\" LONG-NAME=\"Gate\"/>"));
    put("</SPEC-TYPES>\n<SPEC-OBJECTS>");
    let rows = RequirementRow::all(evaluation);
    for (at, row) in rows.iter().enumerate() {
        let result = evaluation.results.get(at);
        let ids = result.map(|result| result.requirement.ids.join(", ")).unwrap_or_default();
        let name = result.map_or("comparison", |result| result.id.as_str());
        let status = row.status.as_str();
        let verdict = evaluation.verdict.as_str();
        let values =
            [&ids, name, &row.requirement, &row.observed, &row.interval, status, verdict, &evaluation.dataset_sha256];
        put(&format!("<SPEC-OBJECT IDENTIFIER=\"requirement-{at}\" LAST-CHANGE=\"{DATE}\">"));
        put("<TYPE><SPEC-OBJECT-TYPE-REF>requirement</SPEC-OBJECT-TYPE-REF></TYPE>\n<VALUES>");
        for ((id, _), value) in ATTRIBUTES.iter().zip(values) {
            put(&format!(
                "<ATTRIBUTE-VALUE-STRING THE-VALUE=\"{}\"><DEFINITION><ATTRIBUTE-DEFINITION-STRING-REF>attribute-{id}\
                 </ATTRIBUTE-DEFINITION-STRING-REF></DEFINITION></ATTRIBUTE-VALUE-STRING>",
                escape(value)
            ));
        }
        put("</VALUES>\n</SPEC-OBJECT>");
    }
    put("</SPEC-OBJECTS>\n<SPECIFICATIONS>");
    put(&format!(
        "<SPECIFICATION IDENTIFIER=\"specification\" LAST-CHANGE=\"{DATE}\" LONG-NAME=\"{}\">",
        escape(&format!("Gate {name}"))
    ));
    put("<TYPE><SPECIFICATION-TYPE-REF>gate</SPECIFICATION-TYPE-REF></TYPE>\n<CHILDREN>");
    for at in 0..rows.len() {
        put(&format!(
            "<SPEC-HIERARCHY IDENTIFIER=\"place-{at}\" LAST-CHANGE=\"{DATE}\"><OBJECT><SPEC-OBJECT-REF>requirement-{at}\
             </SPEC-OBJECT-REF></OBJECT></SPEC-HIERARCHY>"
        ));
    }
    put("</CHILDREN>\n</SPECIFICATION>\n</SPECIFICATIONS>\n</REQ-IF-CONTENT>\n</CORE-CONTENT>\n</REQ-IF>");
    out
}

/// The text with the characters that XML reserves replaced, and without those that it forbids.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\t' | '\n' | '\r' => {
                // Writing to a string cannot fail.
                let _ = write!(escaped, "&#{};", u32::from(c));
            }
            c if is_deceptive(c) || matches!(c, '\u{fffe}' | '\u{ffff}') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_characters_are_escaped() {
        assert_eq!(escape("a<b> & \"c\"\n\u{1}"), "a&lt;b&gt; &amp; &quot;c&quot;&#10;\u{fffd}");
    }
}
