from .named_subjects import list_subjects as list_subjects
from .subject_check import SubjectCheck as SubjectCheck
from .subject_check import check_subject as check_subject
from .subject_facts import SubjectFacts as SubjectFacts
from .subject_facts import describe_subject as describe_subject
from .subject_facts import import_subject as import_subject
from .subject_settle import SettledSubject as SettledSubject
from .subject_settle import settle_subject as settle_subject
